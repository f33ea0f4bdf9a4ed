"""Stiffness of beams out of their plane, against closed forms and finite elements."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from scipy.integrate import quad, solve_bvp

import twistorjax as tj
from twistorjax.energies.sections import torsion_constant


STEEL = tj.Material(modulus=210e9, poisson=0.3)
ALUMINUM = tj.Material(modulus=69e9, poisson=0.33)
LENGTH, THICKNESS = 0.1, 0.5e-3  # m


def leaf(width, **settings):
    sizes = {"length": LENGTH, "thickness": THICKNESS, "width": width, **settings}
    return tj.flexures.Beam(STEEL, **sizes)


def torsional_stiffness(width):
    """Stiffness of a section by the series of Saint-Venant; N m2."""
    odd = np.arange(1, 400, 2)
    series = np.sum(np.tanh(odd * np.pi * width / (2 * THICKNESS)) / odd**5)
    factor = 1 - 192 / np.pi**5 * THICKNESS / width * series
    return STEEL.shear_modulus * THICKNESS**3 * width / 3 * factor


def guided(beam, stroke):
    """Return the state of a leaf whose end is displaced without rotation or tension."""
    force = 12 * beam.rotational_stiffness / LENGTH**2 * stroke
    load = np.array([0.0, 0.0, force])
    bent = tj.flexures.beam_under_load(beam, load)
    for _ in range(4):  # The moment is such that the end does not rotate.
        load[0] -= beam.rotational_stiffness * bent.pose[0]
        load[2] *= stroke / bent.pose[2]
        bent = tj.flexures.beam_under_load(beam, load)
    return bent


def stiffness(beam, solution=None, **settings):
    return np.asarray(tj.flexures.out_of_plane_stiffness(beam, solution, **settings))


@pytest.mark.parametrize(
    ("width", "stroke", "elements", "tolerance"),
    [
        (0.01, 0.0, 102364, 0.01),
        (0.01, 0.005, 85019.5, 0.005),
        (0.01, 0.01, 56500, 0.005),
        (0.02, 0.0, 753965, 0.01),
        (0.05, 0.0, 7549700, 0.02),
        (0.05, 0.01, 1573930, 0.1),
    ],
)
def test_support_stiffness_over_the_stroke(
    width, stroke, elements, tolerance, validated, pictured
):
    """Quadratic solid elements with large displacements; x of the moved end is free."""
    beam = leaf(width)
    bent = guided(beam, stroke) if stroke else tj.flexures.beam_under_load(beam, 3 * [0])
    assert_close(bent.pose[::2], [0.0, stroke], digits=6)
    found = stiffness(beam, bent)[0, 0]
    assert abs(found / elements - 1) < tolerance
    what = f"support stiffness of a leaf, w = {width / LENGTH:g} L, stroke {stroke:g} m"
    validated("Out of the plane", what, found, elements, "solid finite elements")
    beside = np.linspace(1e-4, 0.01, 5)
    pictured(
        "Out of the plane",
        "support-stiffness",
        "Stiffness of a leaf out of the plane, at the end that moves in the plane.",
        ("stroke over length", "stiffness (N/m), logarithmic"),
        {
            f"width {width / LENGTH:g} L": (
                beside / LENGTH,
                [stiffness(beam, guided(beam, other))[0, 0] for other in beside],
            )
        },
        {"solid finite elements": (stroke / LENGTH, elements)},
    )


def test_force_on_a_bent_leaf_twists_it():
    """The law of free torsion holds for small strokes."""
    width, stroke = 0.02, 0.003
    beam = leaf(width)
    found = stiffness(beam, guided(beam, stroke), warping=False)[0, 0]
    inertia = THICKNESS * width**3 / 12
    shear = STEEL.shear_modulus * THICKNESS * width * 10 * 1.3 / (12 + 11 * 0.3)
    bending = LENGTH**3 / (12 * STEEL.modulus * inertia)
    twisting = LENGTH * stroke**2 / (28 * torsional_stiffness(width))
    np.testing.assert_allclose(1 / found, bending + LENGTH / shear + twisting, rtol=3e-3)


@pytest.mark.parametrize(("width", "warping"), [(0.05, 1.304436295101072), (0.005, None)])
def test_torsion_of_a_straight_leaf(width, warping):
    """Restrained warping increases the stiffness by 1 / (1 - tanh(a) / a)."""
    beam = leaf(width)
    free, restrained = (stiffness(beam, warping=each)[1, 1] for each in (False, True))
    torsion = torsional_stiffness(width)
    assert_close(free, torsion / LENGTH)
    sectorial = (width * THICKNESS) ** 3 / 144
    a = LENGTH / 2 * np.sqrt(torsion / (STEEL.modulus * sectorial))
    factor = 1 / (1 - np.tanh(a) / a)
    np.testing.assert_allclose(restrained / free, factor, rtol=1e-8)
    if warping is not None:
        np.testing.assert_allclose(factor, warping, rtol=1e-8)


def test_torsion_constants_of_rectangles():
    """Saint-Venant's constants, to the digits that tables have."""
    known = {1.0: 0.1406, 2.0: 0.2287, 10.0: 0.3123}
    sides = np.array(list(known))
    found = torsion_constant(jnp.asarray(sides), jnp.ones(()))
    np.testing.assert_allclose(found / sides, list(known.values()), atol=6e-5)
    thin = torsion_constant(jnp.array([THICKNESS]), jnp.array(0.05))
    np.testing.assert_allclose(thin, 2.0702031484108172e-12, rtol=1e-10)


def test_an_arc_is_bent_and_twisted_by_a_force_at_its_end():
    """Circular beam in closed form (Timoshenko, Strength of Materials, part 1)."""
    radius, turn, width = 0.05, 1.2, 4e-3
    beam = leaf(width, length=radius * turn, curvature=1 / radius)
    # Displacements of the end are those of frame b and of its rotations.
    x, y = radius * np.sin(turn / 2), radius * (1 - np.cos(turn / 2))
    end = np.array([[1.0, y, -x], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    compliance = end @ np.linalg.inv(stiffness(beam, warping=False)) @ end.T
    bending = STEEL.modulus * THICKNESS * width**3 / 12
    torsion = torsional_stiffness(width)
    shear = STEEL.shear_modulus * THICKNESS * width * 10 * 1.3 / (12 + 11 * 0.3)
    sine = np.sin(2 * turn) / 4
    by_bending = radius**3 / bending * (turn / 2 - sine)
    by_torsion = radius**3 / torsion * (1.5 * turn - 2 * np.sin(turn) + sine)
    exact = by_bending + by_torsion + radius * turn / shear
    np.testing.assert_allclose(compliance[0, 0], exact, rtol=1e-7)


def test_warping_under_an_uneven_torque():
    """The twist rate of a bent leaf, by a boundary value problem."""
    beam, width = leaf(0.03), 0.03
    bent = guided(beam, 0.01)
    _, x, y = np.asarray(bent.centerline).T
    angle = np.asarray(bent.centerline)[:, 0]
    position = LENGTH / 2 * np.sin(np.linspace(-np.pi / 2, np.pi / 2, len(x)))
    at = bent.pose[1:]
    torque = np.cos(angle) * (at[1] - y) - np.sin(angle) * (at[0] - x)
    torsion = torsional_stiffness(width)
    restraint = STEEL.modulus * (width * THICKNESS) ** 3 / 144

    def rates(s, state):
        load = np.polyval(fit, s)
        return np.array([state[1], (torsion * state[0] - load) / restraint])

    fit = np.polyfit(position, torque, 12)
    mesh = np.linspace(-LENGTH / 2, LENGTH / 2, 101)
    found = solve_bvp(
        rates, lambda a, b: np.array([a[0], b[0]]), mesh, np.zeros((2, 101)), tol=1e-9
    )
    twisting = quad(lambda s: np.polyval(fit, s) * found.sol(s)[0], *mesh[[0, -1]])[0]
    compliances = [
        np.linalg.inv(stiffness(beam, bent, warping=warping))[0, 0]
        for warping in (True, False)
    ]
    free = quad(lambda s: np.polyval(fit, s) ** 2 / torsion, *mesh[[0, -1]])[0]
    np.testing.assert_allclose(
        compliances[1] - compliances[0], free - twisting, rtol=1e-5
    )


def test_a_notch_by_integrals_along_its_profile():
    """Values of the reference: a Timoshenko beam of variable thickness."""
    profile = tj.flexures.notch_profile(hole=3e-3, web=0.25e-3)
    beam = tj.flexures.Beam(
        ALUMINUM, length=3e-3, thickness=profile, width=0.02, steps=48
    )
    found = 1 / np.diagonal(np.linalg.inv(stiffness(beam, warping=False)))
    exact = 78967921.9210205, 3.7881667381632855, 8257.211919636387
    np.testing.assert_allclose(found, exact, rtol=1e-7)


@pytest.mark.parametrize(
    ("row", "name", "elements", "tolerance"),
    [
        (0, "along z", 8.423e7, 0.07),
        (1, "in torsion", 663.0, 0.3),
        (2, "in bending", 8300.0, 0.01),
    ],
)
def test_a_wide_notch_between_blocks(row, name, elements, tolerance, validated):
    """Solid elements with quadratic shape functions, 77,409 unknowns, clamped ends."""
    profile = tj.flexures.notch_profile(hole=3e-3, web=0.25e-3)
    beam = tj.flexures.Beam(
        ALUMINUM, length=3e-3, thickness=profile, width=0.02, steps=48
    )
    found = stiffness(beam)[row, row]
    assert abs(found / elements - 1) < tolerance
    what = f"stiffness {name} of a notch, hole 3 mm, web 0.25 mm, width 20 mm"
    validated("Out of the plane", what, found, elements, "solid finite elements")


def test_derivatives_by_the_stroke_and_the_thickness():
    def support(at):
        stroke, thickness = at
        beam = leaf(0.02, thickness=thickness)
        pose = jnp.stack([0 * stroke, -0.6 * stroke**2 / LENGTH, stroke])
        bent = tj.flexures.beam_at_pose(beam, pose)
        return tj.flexures.out_of_plane_stiffness(beam, bent)[0, 0]

    at, scale = np.array([0.008, THICKNESS]), np.array([1e-3, 1e-4])
    value_and_slopes = jax.jit(jax.value_and_grad(support))
    _, slopes = value_and_slopes(at)
    for k in range(2):
        step = 1e-4 * scale[k] * np.eye(2)[k]
        above, below = (value_and_slopes(each)[0] for each in (at + step, at - step))
        difference = (above - below) / (2e-4 * scale[k])
        np.testing.assert_allclose(slopes[k], difference, rtol=1e-6)


def turned_guide(turn=0.0, energy=None, origin=(0.0, 0.0)):
    """Two parallel leaves between a wall and a table, turned in the plane."""
    rotate = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def at(x, y):
        return turn, *(rotate @ np.array([x, y]))

    if energy is None:
        energy = tj.flexures.leaf(STEEL, length=LENGTH, thickness=THICKNESS, width=0.02)
    bodies = [tj.Body("wall"), tj.Body("table", at(LENGTH + origin[0], origin[1]))]
    leaves = [
        tj.Hinge(name, "wall", "table", energy, at=at(LENGTH / 2, y))
        for name, y in (("lower", -0.03), ("upper", 0.03))
    ]
    return tj.Mechanism(bodies, leaves, fixed=["wall"])


def test_a_guide_has_the_stiffness_of_both_leaves():
    """Leaves in parallel, at their points on the table, in the numbers of the beam."""
    guide = turned_guide(energy=tj.flexures.surrogate(leaf(0.02), rotation=0.3))
    state = tj.equilibrium(guide, drives=[tj.Drive("table", y=0.01)])
    expected = np.zeros((3, 3))
    for height in (-0.03, 0.03):
        pose = guide.displacement_of("lower" if height < 0 else "upper", state)
        each = stiffness(leaf(0.02), tj.flexures.beam_at_pose(leaf(0.02), pose))
        arm = np.array([-LENGTH / 2, height])
        moved = np.array([[1.0, arm[1], -arm[0]], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        expected += moved.T @ each @ moved
    found = tj.out_of_plane(guide, state).stiffness_at("table")
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-2)


@pytest.mark.parametrize("turn", [0.7, -2.0])
def test_stiffness_does_not_depend_on_the_axes_of_the_world(turn):
    stroke = 0.008
    results = []
    for angle, origin in ((0.0, (0.0, 0.0)), (turn, (0.02, -0.01))):
        guide = turned_guide(angle, origin=origin)
        along = stroke * np.array([-np.sin(angle), np.cos(angle)])
        drive = tj.Drive("table", angle=0.0, x=along[0], y=along[1])
        state = tj.equilibrium(guide, drives=[drive])
        port = 0.0, -origin[0], -origin[1]
        results.append(tj.out_of_plane(guide, state).compliance_at("table", port))
    np.testing.assert_allclose(results[1], results[0], rtol=1e-8, atol=1e-14)


def test_leaves_and_surrogates_have_the_stiffness_of_the_beam():
    """All hinges of one leaf at one pose, and a straight notch."""
    beam = leaf(0.02)
    unit = beam.rotational_stiffness
    bent = tj.flexures.beam_under_load(beam, [0.1 * unit, 0.0, 0.2 * unit / LENGTH])
    pose = np.stack([np.zeros(3), bent.pose])
    profile = tj.flexures.notch_profile(hole=3e-3, web=0.25e-3)
    notch = tj.flexures.Beam(
        ALUMINUM, length=3e-3, thickness=profile, width=0.02, steps=48
    )
    sizes: dict[str, Any] = {
        "length": LENGTH,
        "thickness": THICKNESS,
        "width": 0.02,
    }
    necked = tj.flexures.notch(ALUMINUM, hole=3e-3, web=0.25e-3, width=0.02)
    for energy, expected, solution, tolerance in (
        (tj.flexures.leaf(STEEL, **sizes), beam, bent, 3e-4),
        (tj.flexures.surrogate(beam, rotation=0.5), beam, bent, 1e-4),
        (tj.flexures.ExactBeam(beam), beam, bent, 1e-7),
        (tj.flexures.linear_leaf(STEEL, **sizes), beam, None, 1e-9),
        (tj.flexures.linear_leaf(STEEL, **sizes), beam, bent, 4e-3),
        (necked, notch, None, 1e-6),
    ):
        found = of_hinge(energy, pose if solution else None)
        exact = stiffness(expected, solution)
        scale = np.sqrt(np.outer(np.diagonal(exact), np.diagonal(exact)))
        error = (found - exact) / scale
        assert np.max(np.abs(error)) < tolerance


REINFORCED: dict[str, Any] = {
    "length": 40e-3,
    "thickness": 0.3e-3,
    "reinforced_length": 28e-3,
    "reinforced_thickness": 2e-3,
}


def of_hinge(energy, about=None, **settings):
    """Stiffness of a hinge between a wall and a block."""
    hinge = tj.Hinge("hinge", "wall", "block", energy, at=(0.0, 0.0, 0.0))
    bodies = [tj.Body("wall"), tj.Body("block")]
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    model = tj.out_of_plane(mechanism, about, **settings)
    return np.asarray(model.stiffness_at("block"))


def test_twist_of_a_leaf_with_a_thick_middle():
    """Hyperbolic functions in each part; twist rate and bimoment do not jump."""
    width = 10e-3
    energy = tj.flexures.reinforced_leaf(STEEL, width=width, **REINFORCED)
    thin, thick = 0.3e-3, 2e-3
    torsion = [
        STEEL.shear_modulus * float(torsion_constant(jnp.array(t), jnp.array(width)))
        for t in (thin, thick)
    ]
    restraint = [STEEL.modulus * (t * width) ** 3 / 144 for t in (thin, thick)]
    outer, inner = (np.sqrt(a / b) for a, b in zip(torsion, restraint, strict=True))
    length, half = 6e-3, 14e-3
    sinh, cosh = np.sinh(outer * length), np.cosh(outer * length)
    # Twist rate by a torque of one: 1/torsion - cosh / torsion + a sinh, and
    # 1/torsion + b cosh
    matrix = [
        [sinh, -np.cosh(inner * half)],
        [restraint[0] * outer * cosh, restraint[1] * inner * np.sinh(inner * half)],
    ]
    known = [
        1 / torsion[1] - (1 - cosh) / torsion[0],
        restraint[0] * outer * sinh / torsion[0],
    ]
    a, b = np.linalg.solve(matrix, known)
    twist = length / torsion[0] - sinh / outer / torsion[0] + a * (cosh - 1) / outer
    twist += half / torsion[1] + b * np.sinh(inner * half) / inner
    free = 2 * (length / torsion[0] + half / torsion[1])
    np.testing.assert_allclose(of_hinge(energy)[1, 1], 1 / (2 * twist), rtol=1e-9)
    found = of_hinge(energy, warping=False)[1, 1]
    np.testing.assert_allclose(found, 1 / free, rtol=1e-9)


def test_a_thick_middle_by_its_energy_and_its_profile():
    """A transition of a thousandth of the length is nearly a jump."""
    energy = tj.flexures.reinforced_leaf(STEEL, width=10e-3, **REINFORCED)
    profile = tj.flexures.reinforced_leaf_profile(transition=4e-5, **REINFORCED)
    beam = tj.flexures.Beam(
        STEEL, length=40e-3, thickness=profile, width=10e-3, steps=512
    )
    bent = tj.flexures.beam_under_load(beam, [0.01, 0.0, 0.5])
    pose = np.stack([np.zeros(3), bent.pose])
    for about, solution in ((None, None), (pose, bent)):
        found, exact = of_hinge(energy, about), stiffness(beam, solution)
        scale = np.sqrt(np.outer(np.diagonal(exact), np.diagonal(exact)))
        assert np.max(np.abs(found - exact) / scale) < 1e-3


def test_stiffness_that_is_not_known_is_asked_for():
    spring = tj.Quadratic(np.eye(3))
    guide = turned_guide(energy=spring)
    with pytest.raises(ValueError, match="of 'lower', 'upper' is not known"):
        tj.out_of_plane(guide)
    given = np.diag([1e3, 2.0, 3.0])
    found = tj.out_of_plane(guide, hinges={"lower": given, "upper": given})
    assert repr(found) == "stiffness out of the plane of 2 bodies; fixed: 'wall'"
    about_x = 2 * (2.0 + 1e3 * 0.03**2)
    expected = np.diag([2e3, about_x, 6.0])
    port = 0.0, -LENGTH / 2, 0.0
    assert_close(found.stiffness_at("table", port), expected, digits=9)
    with pytest.raises(ValueError, match="names the hinge 'middle'"):
        tj.out_of_plane(guide, hinges={"middle": given})
    with pytest.raises(ValueError, match="'wall' cannot move out"):
        found.compliance_at("wall")
    with pytest.raises(RuntimeError, match="'table' can move out of the plane"):
        tj.out_of_plane(guide, hinges=dict.fromkeys(["lower", "upper"], 0 * given))


def test_a_divided_leaf_is_as_stiff_as_a_whole_one():
    """Segments warp where they meet, and the ends of the leaf do not."""
    beam, stroke = leaf(0.05), 0.01
    part = tj.flexures.chain(
        "leaf", beam, "wall", "table", at=(0.0, LENGTH / 2, 0.0), segments=3, error=0.1
    )
    bodies = [tj.Body("wall"), tj.Body("table", (0.0, LENGTH, 0.0)), *part.bodies]
    divided = tj.Mechanism(bodies, part.hinges, fixed=["wall"])
    state = tj.equilibrium(divided, drives=[tj.Drive("table", angle=0.0, y=stroke)])
    bent = tj.flexures.beam_at_pose(beam, state.displacement("table"))
    middle = 0.0, -LENGTH / 2, 0.0
    for about, solution, tolerance in ((None, None, 1e-9), (state, bent, 3e-4)):
        for warping in (True, False):
            found = tj.out_of_plane(divided, about, warping=warping)
            exact = stiffness(beam, solution, warping=warping)
            scale = np.sqrt(np.outer(np.diagonal(exact), np.diagonal(exact)))
            error = (np.asarray(found.stiffness_at("table", middle)) - exact) / scale
            assert np.max(np.abs(error)) < tolerance


def test_hinges_consist_of_their_parts():
    """A pivot as one hinge, by its energy, its outline, or as an argument."""
    thin = tj.flexures.leaf(STEEL, length=LENGTH, thickness=THICKNESS, width=0.02)
    pivot = tj.flexures.cross_spring_pivot(leaf(0.02), thin)
    at = 0.4, 0.03, -0.02
    wall, arm = tj.Body("wall"), tj.Body("arm", (0.2, 0.1, 0.05))
    leaves = [
        tj.Hinge(f"leaf {k}", "wall", "arm", thin, at=(0.4 + turn, *at[1:]))
        for k, turn in enumerate((np.pi / 4, -np.pi / 4))
    ]
    whole = tj.Mechanism([wall, arm], leaves, fixed=["wall"])
    state = tj.equilibrium(whole, drives=[tj.Drive("arm", angle=0.15)])
    expected = tj.out_of_plane(whole, state).stiffness_at("arm")
    fixed = tj.Quadratic(np.eye(3))
    for energy, outline, argument in (
        (tj.flexures.Condensed(pivot), None, None),
        (fixed, pivot, None),
        (fixed, None, {"pivot": pivot}),
    ):
        hinge = tj.Hinge("pivot", "wall", "arm", energy, at=at, outline=outline)
        mechanism = tj.Mechanism([wall, arm], [hinge], fixed=["wall"])
        found = tj.out_of_plane(mechanism, state, hinges=argument)
        assert_close(found.stiffness_at("arm"), expected, digits=8)


def test_derivative_of_the_support_stiffness_by_the_stroke():
    def support(stroke):
        guide = turned_guide()
        state = tj.equilibrium(guide, drives=[tj.Drive("table", y=stroke)])
        return tj.out_of_plane(guide, state).compliance_at("table")[0, 0]

    with_slope = jax.jit(jax.value_and_grad(support))
    _, slope = with_slope(0.008)
    above, below = (with_slope(0.008 + step)[0] for step in (1e-6, -1e-6))
    np.testing.assert_allclose(slope, (above - below) / 2e-6, rtol=1e-6)
