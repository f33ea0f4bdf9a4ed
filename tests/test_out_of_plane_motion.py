"""Vibrations, sag, and responses out of the plane, against closed forms."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from scipy.optimize import brentq

import twistorjax as tj


STEEL = tj.Material(modulus=210e9, poisson=0.3, density=7800.0)
SIZES: dict[str, Any] = {"length": 40e-3, "thickness": 0.3e-3, "width": 10e-3}
TABLE = np.array([[40.0, -5.0], [60.0, -5.0], [60.0, 30.0], [40.0, 20.0]]) * 1e-3


def guide(thickness=0.3e-3):
    """Two leaves of different places, and a table that is not symmetric."""
    leaf = tj.flexures.leaf(STEEL, **{**SIZES, "thickness": thickness})
    bodies = [tj.Body("wall"), tj.plate("table", TABLE, width=8e-3, material=STEEL)]
    leaves = [
        tj.Hinge(name, "wall", "table", leaf, at=(0.0, 0.02, y))
        for name, y in (("lower", 0.0), ("upper", 15e-3))
    ]
    return tj.Mechanism(bodies, leaves, fixed=["wall"])


def test_inertia_of_plates():
    """A square with a corner cut off, by its parts, in axes parallel to those of x, y."""
    corners = [[0.0, 0.0], [0.2, 0.0], [0.2, 0.1], [0.1, 0.2], [0.0, 0.2]]
    body = tj.plate("plate", corners, width=0.01, material=STEEL)
    # Moments of a square of the side a about its corner, and of a triangle about its own
    # center: a^4 / 3, a^4 / 4; b^4 / 36, -b^4 / 72
    square, corner = 0.2**2, 0.1**2 / 2
    center = np.array([0.2 - 0.1 / 3, 0.2 - 0.1 / 3])
    inner = 0.1**4 / 36 * np.array([[1.0, 0.0], [0.0, 1.0]])
    inner -= 0.1**4 / 72 * np.array([[0.0, 1.0], [1.0, 0.0]])
    second = 0.2**4 * np.array([[1 / 3, 1 / 4], [1 / 4, 1 / 3]])
    second -= inner + corner * np.outer(center, center)
    area = square - corner
    middle = (0.1 * np.ones(2) * square - center * corner) / area
    assert_close(body.pose[1:], middle)
    second -= area * np.outer(middle, middle)
    about_axes = (np.trace(second) + area * 0.01**2 / 12) * np.eye(2) - second
    assert_close(body.tilt_inertia, 7800.0 * 0.01 * about_axes)
    assert_close(body.inertia, 7800.0 * 0.01 * np.trace(second))


def test_vibrations_of_a_body_by_its_matrices():
    """The generalized eigenvalue problem of the compliance and the inertia."""
    mechanism = guide()
    model = tj.out_of_plane(mechanism)
    found = model.vibrations()
    table = mechanism.tilt_inertias[1]
    inertia = np.zeros((3, 3))
    inertia[0, 0], inertia[1:, 1:] = mechanism.masses[1], table
    compliance = np.asarray(model.compliance_at("table"))
    squares = np.sort(1 / np.linalg.eigvals(compliance @ inertia).real)
    assert_close(found.frequencies, np.sqrt(squares) / (2 * np.pi), digits=9)
    shapes = np.asarray(found.shapes)[:, 1]
    assert_close(shapes @ inertia @ shapes.T, np.eye(3), digits=9)
    assert repr(found).startswith("successful: 3 vibrations out of the plane")
    columns = {"shape_z", "shape_rotation_x", "shape_rotation_y"}
    assert set(found.to_xarray()) == {"frequency", *columns}
    assert_close(model.vibrations(modes=1).frequencies, found.frequencies[:1])


def test_modes_do_not_depend_on_the_axes_of_the_world():
    """The inertia of a body turns with it."""
    leaf, found = tj.flexures.leaf(STEEL, **SIZES), []
    inertia = np.array([[3e-5, 4e-6], [4e-6, 1e-5]])
    for turn in (0.0, 0.8):
        cos, sin = np.cos(turn), np.sin(turn)
        axes = np.array([[cos, -sin], [sin, cos]])
        pose, at = (turn, *(axes @ [0.05, 0.01])), (turn, *(axes @ [0.02, 0.0]))
        table = tj.Body("table", pose, 0.1, 3e-5, tilt_inertia=inertia)
        hinge = tj.Hinge("leaf", "wall", "table", leaf, at=at)
        mechanism = tj.Mechanism([tj.Body("wall"), table], [hinge], fixed=["wall"])
        found.append(tj.out_of_plane(mechanism).vibrations().frequencies)
    assert_close(*found, digits=9)


def strip(width):
    """A leaf that is clamped at one end, with its mass."""
    length, thickness = 0.1, 0.5e-3
    beam = tj.flexures.Beam(STEEL, length=length, thickness=thickness, width=width)
    at = 0.0, length / 2, 0.0
    leaf = tj.flexures.chain("leaf", beam, "wall", "tip", at, segments=12, error=0.1)
    assert leaf.end_masses is not None
    mass = float(leaf.end_masses[1])
    squares = thickness**2, width**2
    tilt_inertia = mass / 12 * np.diag([sum(squares), squares[1]])
    tip = tj.Body(
        "tip", (0.0, length, 0.0), mass, mass * squares[0] / 12, tilt_inertia=tilt_inertia
    )
    bodies = [tj.Body("wall"), tip, *leaf.bodies]
    return tj.Mechanism(bodies, leaf.hinges, fixed=["wall"])


def test_clamped_strips_bend_and_twist(validated):
    """Euler's beam; torsion of a bar of which only the free end can warp."""
    length, thickness, modulus, density = 0.1, 0.5e-3, 210e9, 7800.0
    for width, bends in ((2e-3, True), (0.02, False)):
        found = tj.out_of_plane(strip(width)).vibrations(6)
        shapes = np.asarray(found.shapes)[:, 1]
        twists = np.abs(shapes[:, 0]) < 1e-6 * np.max(np.abs(shapes), axis=1)
        frequencies = np.asarray(found.frequencies)
        if bends:
            slenderness = np.sqrt(modulus * width**2 / 12 / density)
            euler = 1.8751040687**2 / (2 * np.pi * length**2) * slenderness
            bending = frequencies[~twists][0]
            np.testing.assert_allclose(bending, euler, rtol=1e-3)
            what = "first frequency of a clamped strip, bending"
            validated("Out of the plane", what, bending, euler, "Euler's beam")
        odd = np.arange(1, 400, 2)
        series = np.sum(np.tanh(odd * np.pi * width / (2 * thickness)) / odd**5)
        factor = 1 - 192 / np.pi**5 * thickness / width * series
        torsion = modulus / 2.6 * thickness**3 * width / 3 * factor
        restraint = modulus * (width * thickness) ** 3 / 144
        polar = density * thickness * width * (thickness**2 + width**2) / 12

        def characteristic(omega, torsion=torsion, restraint=restraint, polar=polar):
            root = np.sqrt(torsion**2 + 4 * restraint * polar * omega**2)
            p = np.sqrt((torsion + root) / (2 * restraint))
            q = np.sqrt((root - torsion) / (2 * restraint))
            # exp(-p x), exp(p (x - L)), cos(q x), sin(q x): twist and twist rate are zero
            # at the clamp, bimoment and torque at the free end.
            end, cos, sin = np.exp(-p * length), np.cos(q * length), np.sin(q * length)
            torques = [torsion * k - restraint * k**3 for k in (p, -p)]
            rows = [
                [1.0, end, 1.0, 0.0],
                [-p, p * end, 0.0, q],
                [p**2 * end, p**2, -(q**2) * cos, -(q**2) * sin],
                [torques[0] * end, torques[1], 0.0, 0.0],
            ]
            viscous = torsion * q + restraint * q**3
            rows[3][2:] = [viscous * sin, -viscous * cos]
            matrix = np.array(rows)
            return np.linalg.det(matrix / np.max(np.abs(matrix), axis=1, keepdims=True))

        free = np.pi / (2 * length) * np.sqrt(torsion / polar)
        exact = brentq(characteristic, 0.9 * free, 1.9 * free) / (2 * np.pi)
        twisting = frequencies[twists][0]
        np.testing.assert_allclose(twisting, exact, rtol=1e-3)
        what = f"first frequency of a clamped strip, torsion, w = {width:g} m"
        validated("Out of the plane", what, twisting, exact, "Vlasov's bar")


def test_forces_and_weights_displace_the_bodies():
    model = tj.out_of_plane(guide())
    compliance = np.asarray(model.compliance_at("table"))
    found = model.response({"table": (2.0, 0.01, -0.02)})
    assert_close(found.displacement("table"), compliance @ [2.0, 0.01, -0.02])
    assert_close(found.displacement("wall"), np.zeros(3))
    mass = guide().masses[1]
    sag = model.response(gravity=-9.81).displacement("table")
    assert_close(sag, compliance @ [-9.81 * mass, 0.0, 0.0])
    assert set(found.to_xarray()) == {"z", "rotation_x", "rotation_y"}
    assert repr(found).splitlines()[1].startswith("wall ")


def test_harmonic_forces_against_the_equations_of_motion():
    mechanism, ratio = guide(), 0.02
    model = tj.out_of_plane(mechanism)
    push = {"table": (1.0, 0.0, 0.02)}
    frequencies = np.array([0.0, 100.0, 317.0])
    found = model.frequency_response(frequencies, push, damping_ratio=ratio)
    assert_close(
        found.displacement("table")[0], model.response(push).displacement("table")
    )
    inertia = np.zeros((3, 3))
    inertia[0, 0], inertia[1:, 1:] = mechanism.masses[1], mechanism.tilt_inertias[1]
    stiffness = np.asarray(model.stiffness_at("table"))
    natural = model.vibrations()
    angular, shapes = 2 * np.pi * natural.frequencies, np.asarray(natural.shapes)[:, 1].T
    modal = inertia @ shapes
    damping = modal @ np.diag(2 * ratio * angular) @ modal.T
    for row, frequency in enumerate(frequencies):
        omega = 2 * np.pi * frequency
        dynamic = stiffness - omega**2 * inertia + 1j * omega * damping
        exact = np.linalg.solve(dynamic, push["table"])
        np.testing.assert_allclose(found.displacement("table")[row], exact, rtol=1e-9)
    inputs, outputs = (
        {"push": push},
        {"z": ("table", "z"), "tilt": ("table", "rotation_y")},
    )
    space = model.state_space(inputs, outputs, damping_ratio=ratio)
    ratios = space.frequency_response(frequencies)
    amplitudes = found.displacement("table")[:, np.array([0, 2])]
    np.testing.assert_allclose(ratios[..., 0], amplitudes, rtol=1e-9)
    reduced = model.state_space(inputs, outputs, modes=1, damping_ratio=ratio)
    assert_close(reduced.static_gain[:, 0], amplitudes[0].real, digits=9)
    resonance = [float(natural.frequencies[0])]
    with pytest.raises(RuntimeError, match="a resonance without damping"):
        model.frequency_response(resonance, push)


def test_derivative_of_a_frequency_by_thickness_and_stroke():
    def lowest(at):
        thickness, stroke = at
        mechanism = guide(thickness)
        state = tj.equilibrium(mechanism, drives=[tj.Drive("table", y=stroke)])
        return tj.out_of_plane(mechanism, state).vibrations().frequencies[0]

    at, scale = np.array([0.3e-3, 3e-3]), np.array([1e-4, 1e-3])
    with_slope = jax.jit(jax.value_and_grad(lowest))
    _, slopes = with_slope(at)
    for k in range(2):
        step = 1e-3 * scale[k] * np.eye(2)[k]
        above, below = (with_slope(each)[0] for each in (at + step, at - step))
        np.testing.assert_allclose(
            slopes[k], (above - below) / (2e-3 * scale[k]), rtol=1e-6
        )


def test_batches_are_loops():
    mechanism, push = guide(), {"table": (1.0, 0.0, 0.0)}

    def evaluate(stroke):
        state = tj.equilibrium(mechanism, drives=[tj.Drive("table", y=stroke)])
        model = tj.out_of_plane(mechanism, state)
        return (
            model.vibrations().frequencies,
            model.response(push, gravity=-9.81).displacements,
            model.frequency_response([50.0], push, damping_ratio=0.01).displacements,
            model.stiffness_at("table"),
        )

    strokes = jnp.array([0.0, 1e-3, 3e-3])
    batch = jax.vmap(evaluate)(strokes)
    states = jax.vmap(
        lambda stroke: tj.equilibrium(mechanism, drives=[tj.Drive("table", y=stroke)])
    )(strokes)
    model = tj.out_of_plane(mechanism, states)
    assert_close(model.vibrations().frequencies, batch[0], digits=9)
    for row, stroke in enumerate(strokes):
        for found, expected in zip(batch, evaluate(stroke), strict=True):
            assert_close(found[row], expected, digits=9)


def test_vibrations_in_the_plane_warn_of_lower_ones_out_of_it():
    """If they are lower than one that is listed, or unknown."""
    mechanism = guide()
    lowest = float(tj.out_of_plane(mechanism).vibrations().frequencies[0])
    text = repr(tj.vibrations(mechanism))
    assert "3 vibrations in the plane" in text
    assert f"out of the plane from {lowest:.6g} Hz on" in text
    assert "out of the plane" not in repr(tj.vibrations(mechanism, modes=1))
    # A body without `tilt_inertia`
    leaf = tj.flexures.leaf(STEEL, **SIZES)
    hinge = tj.Hinge("leaf", "wall", "table", leaf, at=(0.0, 0.02, 0.0))
    bodies = [tj.Body("wall"), tj.Body("table", (0.0, 0.05, 0.0), mass=0.1, inertia=1e-5)]
    without = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    assert "Those out of the plane are unknown" in repr(tj.vibrations(without))


def test_missing_masses_are_asked_for():
    leaf = tj.flexures.leaf(STEEL, **SIZES)
    hinge = tj.Hinge("leaf", "wall", "table", leaf, at=(0.0, 0.02, 0.0))

    def model(**settings):
        bodies = [tj.Body("wall"), tj.Body("table", (0.0, 0.05, 0.0), **settings)]
        return tj.out_of_plane(tj.Mechanism(bodies, [hinge], fixed=["wall"]))

    with pytest.raises(ValueError, match=r"'table' can move .* no `mass`"):
        model().response(gravity=-9.81)
    with pytest.raises(ValueError, match=r"'table' can move .* no `tilt_inertia`"):
        model(mass=0.1, inertia=1e-5).vibrations()
    for wrong in (np.diag([1.0, -1.0]), np.array([[1.0, 0.5], [0.0, 1.0]])):
        with pytest.raises(ValueError, match="symmetric and positive definite"):
            model(tilt_inertia=wrong)


def test_parallel_leaves_are_over_constrained_once():
    """Each of them resists a force along z and a moment; the table has three freedoms."""
    found = tj.out_of_plane(guide()).constraint_analysis()
    assert found.motions.shape == (0, 2, 3)
    expected = {f"moment about axis 2 of {name!r}" for name in ("lower", "upper")}
    assert set(found.releases[0]) == expected
    leaf = tj.flexures.leaf(STEEL, **SIZES)
    hinge = tj.Hinge("leaf", "wall", "table", leaf, at=(0.3, 0.02, 0.0))
    bodies = [tj.Body("wall"), tj.Body("table")]
    single = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    twist = tj.out_of_plane(single).constraint_analysis()
    assert twist.self_stresses.size == 0
    about_leaf = np.array([np.cos(0.3), np.sin(0.3)])
    rotation = twist.motions[0, 1, 1:]
    across = np.array([-about_leaf[1], about_leaf[0]])
    np.testing.assert_allclose(rotation @ across, 0.0, atol=1e-9)
    described = "motion of 'table', mainly rotation_x of 'table'"
    assert twist.motion_descriptions == (described,)


def test_stiffness_of_a_guide_over_its_stroke():
    """Forces, and small loads in addition to the drive, at the end of the stroke."""
    mechanism, port = guide(), (0.3, -0.03, 5e-3)
    stroke = tj.Drive("table", y=3e-3)
    found = tj.stiffness_over_stroke(mechanism, stroke, port, positions=4)
    assert set(found.support) == {"angle", "x", "z", "rotation_1", "rotation_2"}

    def state(travel, loads=()):
        drives = [tj.Drive("table", y=travel)]
        return tj.equilibrium(mechanism, drives=drives, loads=loads)

    end, step = state(3e-3), 1e-5
    assert_close(found.force[-1], end.reaction("table")[2], digits=9)
    forces = [state(3e-3 + side * step).reaction("table")[2] for side in (1, -1)]
    slope = (forces[0] - forces[1]) / (2 * step)
    np.testing.assert_allclose(found.driving[-1], slope, rtol=1e-5)
    # A small force along axis 1 of the port, and the displacement in its direction
    angle = float(end.displacement("table")[0]) + port[0]
    axis, load = np.array([np.cos(angle), np.sin(angle)]), 1e-2
    arm = np.array([port[1], port[2]])
    displaced = []
    for side in (1, -1):
        push = tj.Load("table", force=side * load * axis, at=arm)
        turn, x, y = state(3e-3, [push]).displacement("table")
        cos, sin = np.cos(turn), np.sin(turn)
        displaced.append(np.array([[cos, -sin], [sin, cos]]) @ arm + [x, y])
    compliance = (displaced[0] - displaced[1]) @ axis / (2 * load)
    np.testing.assert_allclose(found.in_plane[-1, 1, 1], compliance, rtol=1e-4)
    expected = tj.out_of_plane(mechanism, end).compliance_at("table", port)
    assert found.out_of_plane is not None
    np.testing.assert_allclose(found.out_of_plane[-1], expected, rtol=1e-8, atol=1e-15)
    columns = {"force", "driving", *(f"support_{name}" for name in found.support)}
    assert set(found.to_xarray()) == columns
    figure = tj.plotting.draw_stiffness(found)
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "stiffness (N/m)",
        "stiffness (N m/rad)",
    ]


def test_stiffness_of_a_pivot_over_its_stroke():
    """Its hinges are not known out of the plane; the port is on another body."""
    spring = tj.Quadratic(np.diag([0.5, 4e5, 3e5]))
    at = 0.0, 0.0, 0.0
    hinges = [
        tj.Hinge("pivot", "wall", "arm", spring, at=at),
        tj.Hinge("arm", "arm", "tip", spring, at=(0.0, 0.1, 0.0)),
    ]
    bodies = [tj.Body("wall"), tj.Body("arm"), tj.Body("tip", (0.0, 0.1, 0.0))]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["wall"])
    found = tj.stiffness_over_stroke(mechanism, tj.Drive("arm", angle=0.2), positions=2)
    assert found.out_of_plane is None
    assert "the stiffness of a hinge is not known" in repr(found)
    # Its moment is that of the sine of the angle.
    assert_close(found.driving, [0.5, 0.5 * np.cos(0.2)], digits=9)
    assert set(found.support) == {"x", "y"}
    of_tip = tj.stiffness_over_stroke(
        mechanism, tj.Drive("arm", angle=0.2), body="tip", positions=2
    )
    assert set(of_tip.support) == {"angle", "x", "y"}
    assert_close(of_tip.support["angle"], [0.5, 0.5], digits=9)
    assert_close(of_tip.support["x"][0], 2e5, digits=9)
    with pytest.raises(ValueError, match="the input is one coordinate"):
        tj.stiffness_over_stroke(mechanism, tj.Drive("arm", angle=0.2, x=0.0))


def test_spatial_compliance_has_both_blocks():
    mechanism, port = guide(), (0.3, -0.03, 5e-3)
    found = np.asarray(tj.spatial_compliance(mechanism, "table", port))
    in_plane = tj.port_compliance(mechanism, "table", port).compliance
    outside = tj.out_of_plane(mechanism).compliance_at("table", port)
    assert_close(found[2:5, 2:5], in_plane)
    assert_close(found[np.ix_([5, 0, 1], [5, 0, 1])], outside)
    assert np.count_nonzero(found) <= 18


def drawn_corners(axes):
    """Return the corners of the table, behind which its outline at rest is drawn; mm."""
    return np.asarray(axes.collections[2].get_paths()[0].vertices)[:-1]


def test_oblique_views():
    """A tilted table; the ends of the leaves are on the wall and on the table."""
    mechanism = guide()
    model = tj.out_of_plane(mechanism)
    tilted = model.response({"table": (0.0, 1.0, 0.0)})
    axes = tj.plotting.draw_out_of_plane(mechanism, tilted, magnify=20.0)
    assert axes.get_title() == "displacements out of the plane, magnified 20 times"
    z, about_x, about_y = np.asarray(tilted.displacement("table"))
    offsets = TABLE - np.asarray(mechanism.reference)[1, 1:]
    heights = 20 * (z + about_x * offsets[:, 1] - about_y * offsets[:, 0])
    table = drawn_corners(axes)
    x, y = 1e3 * TABLE.T
    expected = np.stack([x + 0.45 * y, 0.55 * y + 1e3 * heights], axis=1)
    np.testing.assert_allclose(table, expected, atol=1e-6)
    modes = model.vibrations()
    axes = tj.plotting.draw_out_of_plane(mechanism, modes, mode=1)
    second = f"out of the plane at {modes.frequencies[1]:.5g} Hz"
    assert second in axes.get_title()
    moving = axes.figure.add_subplot()
    animation = tj.animate(mechanism, modes, mode=1, frames=4, axes=moving)
    assert "<script" in animation.to_jshtml()
    heights = []
    for frame in range(4):
        animation._draw_frame(frame)  # pyright: ignore[reportAttributeAccessIssue]
        heights.append(np.ptp(drawn_corners(moving)[:, 1]))
    assert_close(heights[0], heights[2])  # The table is flat.
    assert abs(heights[1] - heights[3]) > 1.0  # It is tilted to both sides; mm.
    assert second in moving.get_title()
    response = model.frequency_response([10.0], {"table": (1.0, 0.0, 0.0)})
    with pytest.raises(ValueError, match="a frequency response"):
        tj.plotting.draw_out_of_plane(mechanism, response)
    with pytest.raises(ValueError, match="there are 3 vibrations"):
        tj.plotting.draw_out_of_plane(mechanism, modes, mode=3)


def test_designs_in_sweeps_and_optimizations():
    """A limit on the lowest frequency out of the plane, and its derivative."""

    def study(design):
        model = tj.out_of_plane(guide(design["thickness"]))
        frequency = model.vibrations().frequencies[0]
        return {"frequency": frequency, "stiffness": design["thickness"] ** 3}

    thicknesses = np.array([0.2999e-3, 0.3e-3, 0.3001e-3])
    swept = tj.sweep(study, {"thickness": thicknesses}, derivatives=("frequency",))
    below, middle, above = swept["frequency"].values
    difference = (above - below) / (thicknesses[2] - thicknesses[0])
    slope = swept["frequency_by_thickness"].values[1]
    np.testing.assert_allclose(slope, difference, rtol=1e-6)
    start = tj.Parameter(0.4e-3, lower=0.1e-3, upper=1e-3)
    found = tj.optimize(
        study, {"thickness": start}, minimize="stiffness",
        limits={"frequency": tj.Limit(lower=middle)},
    )  # fmt: skip
    np.testing.assert_allclose(found.parameters["thickness"], 0.3e-3, rtol=1e-6)
