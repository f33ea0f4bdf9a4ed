"""Drawings, animations and charts, checked by their artists in matplotlib."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest


mpl.use("agg")

import matplotlib.pyplot as plt
from helpers import assert_close
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.contour import ContourSet
from matplotlib.patches import Circle, FancyArrowPatch, Polygon
from matplotlib.text import Annotation

import twistorjax as tj
from twistorjax.examples import four_bar, stage
from twistorjax.geometry import se2
from twistorjax.plotting import figure_style


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def polygons(axes):
    """Corners of the parts that are drawn; the first and the last one coincide."""
    return corners_of(c for c in axes.collections if isinstance(c, PolyCollection))


def corners_of(collections):
    return [
        np.asarray(path.vertices) for drawn in collections for path in drawn.get_paths()
    ]


def test_a_body_is_drawn_at_its_magnified_displacement_in_millimeters():
    mechanism = stage.microstage()
    poses = np.array(mechanism.reference)
    poses[5, 1] += 1e-3
    axes = tj.draw(mechanism, poses, reference=False, magnify=2.0)
    corners = polygons(axes)[5][:-1]
    outline = mechanism.outlines[5]
    assert outline is not None
    outline = np.asarray(outline) + np.asarray(mechanism.reference)[5, 1:]
    assert_close(corners, 1e3 * outline + np.array([2.0, 0.0]))
    assert "magnified 2 times" in axes.get_title()


def test_a_hinge_is_drawn_between_its_two_bodies():
    """The ends of a notch hinge move with the bodies that it joins."""
    mechanism = stage.microstage()
    solution = stage.amplification(mechanism).equilibrium
    axes = tj.draw(mechanism, solution.poses, reference=False, magnify=80.0)
    at, references = np.asarray(mechanism.at), np.asarray(mechanism.reference)
    hinge = polygons(axes)[len(mechanism.names)][:-1]  # hinge a: bodies 2 and 6
    outline = np.asarray(mechanism.hinge_outlines[0])
    for end, name in ((outline[:, 0].argmin(), "2"), (outline[:, 0].argmax(), "6")):
        reference = references[mechanism.index(name)]
        corner = at[0, 1:] + outline[end]
        pose = reference + 80 * np.asarray(solution.displacement(name))
        expected = se2.act(jnp.asarray(pose), jnp.asarray(corner - reference[1:]))
        assert_close(hinge[end], 1e3 * np.asarray(expected), digits=10)


def test_the_reference_configuration_is_drawn_behind_the_deformed_one():
    mechanism = stage.microstage()
    solution = stage.amplification(mechanism).equilibrium
    both = tj.draw(mechanism, solution.poses)
    deformed = tj.draw(mechanism, solution.poses, reference=False)
    assert len(polygons(both)) == len(polygons(deformed)) + len(mechanism.names)


def test_bodies_and_hinges_without_outlines_are_drawn_as_arms_and_springs():
    spring = tj.Quadratic(np.eye(3))
    mechanism = tj.Mechanism(
        [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))],
        [tj.Hinge("h", "a", "b", spring, at=(0.0, 0.5, 0.0))],
        fixed=["a"],
    )
    axes = tj.draw(mechanism)
    assert len(polygons(axes)) == 3  # two lines and a spring
    assert {text.get_text() for text in axes.texts} == {"a", "b", "h"}


def _area(corners):
    x, y = corners.T
    return abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2


def test_flexures_without_outlines_are_drawn_by_their_contours():
    """Areas and lengths between the bodies follow from the dimensions (mm)."""
    steel = tj.Material(modulus=210e9, poisson=0.3)
    sizes: dict[str, Any] = {"length": 40e-3, "thickness": 1e-3, "width": 10e-3}
    reinforced: dict[str, Any] = {
        "reinforced_length": 28e-3,
        "reinforced_thickness": 4e-3,
    }
    arc = tj.flexures.Beam(steel, curvature=20.0, **sizes)
    half_chord = np.sin(0.4) / 20e-3
    sagitta = (1 - np.cos(0.4)) / 20e-3
    edge = 0.5 * np.sin(0.4)
    for energy, area, length, height in (
        (tj.flexures.leaf(steel, **sizes), 40.0, 40.0, 1.0),
        (2 * tj.flexures.linear_leaf(steel, **sizes), 40.0, 40.0, 1.0),
        (tj.flexures.reinforced_leaf(steel, **sizes, **reinforced), 124.0, 40.0, 4.0),
        (
            tj.flexures.notch(steel, hole=10e-3, web=1e-3, width=10e-3),
            10 * 11 - 25 * np.pi,
            10.0,
            11.0,
        ),
        (
            tj.flexures.ExactBeam(arc),
            40.0,
            2 * (half_chord + edge),
            sagitta + 0.5 * (1 + np.cos(0.4)),
        ),
    ):
        hinge = tj.Hinge("h", "a", "b", energy, at=(0.0, 0.0, 0.0))
        mechanism = tj.Mechanism([tj.Body("a"), tj.Body("b")], [hinge], fixed=["a"])
        corners = polygons(tj.draw(mechanism, names=False))[-1][:-1]
        np.testing.assert_allclose(_area(corners), area, rtol=2e-3)
        np.testing.assert_allclose(np.ptp(corners, axis=0), [length, height], rtol=1e-4)


def between_two_bodies(energy, at=(0.0, 50.0, 0.0)):
    bodies = [tj.Body("a"), tj.Body("b", (0.0, 0.1, 0.0))]
    hinge = tj.Hinge("h", "a", "b", energy, at=(at[0], 1e-3 * at[1], 1e-3 * at[2]))
    return tj.Mechanism(bodies, [hinge], fixed=["a"])


def test_an_actuator_is_drawn_with_its_dimensions_and_pushes_its_body():
    size: dict[str, float] = {"length": 18e-3, "width": 5e-3}
    stack = tj.flexures.piezo_stack(free_stroke=15e-6, blocking_force=800.0, **size)
    mechanism = between_two_bodies(stack)
    (corners,) = polygons(tj.draw(mechanism, names=False))[2:]
    np.testing.assert_allclose(np.ptp(corners, axis=0), [18.0, 5.0])
    driven = mechanism.with_strokes({"h": (0.0, 15e-6, 0.0)})
    axes = tj.draw(driven, tj.equilibrium(driven), magnify=100, reference=False)
    (corners,) = polygons(axes)[2:]
    np.testing.assert_allclose(np.ptp(corners, axis=0), [18.0 + 1.5, 5.0])


def test_a_stiffness_that_is_not_that_of_a_slender_beam_is_drawn_as_a_spring():
    for diagonal in ([1e-3, 1e4, 1e4], [1e3, 1e9, 1e4]):  # a block; longer than 0.1 m
        drawn = polygons(tj.draw(between_two_bodies(tj.Quadratic(np.diag(diagonal)))))
        np.testing.assert_allclose(drawn[-1][0], [50.0, 0.0], atol=1e-9)
        assert np.all(np.ptp(drawn[-1], axis=0) < 10.0)


@pytest.mark.parametrize(
    ("direction", "gap", "step"),
    [
        ("+y", 2e-3, (0.0, 0.0, 2e-3)),
        ("-x", 3e-3, (0.0, -3e-3, 0.0)),
        ("-angle", 0.2, (-0.2, 0.0, 0.0)),
    ],
)
def test_the_faces_of_a_stop_meet_where_its_gap_is_closed(direction, gap, step):
    stop = tj.energies.Stop(direction, gap=gap, stiffness=1e6, smoothing=1e-5)
    mechanism = between_two_bodies(stop, at=(0.3, 100.0, 0.0))
    reached = np.array(mechanism.reference)
    along = np.array([np.cos(0.3), np.sin(0.3)])  # axis 1 of the hinge
    across = np.array([-along[1], along[0]])
    reached[1] += [step[0], *(step[1] * along + step[2] * across)]
    for magnify in (1.0, 0.5):
        apart, closed = (
            polygons(tj.draw(mechanism, poses, reference=False, magnify=magnify))[-2:]
            for poses in (None, reached)
        )
        np.testing.assert_allclose(closed[0], closed[1], atol=1e-9)
        assert np.max(np.abs(apart[0] - apart[1])) > 0.1


def test_all_names_or_some_can_be_left_out():
    mechanism = stage.microstage()
    assert not tj.draw(mechanism, names=False).texts
    shown = tj.draw(mechanism, names=["a", "6"]).texts
    assert {text.get_text() for text in shown} == {"a", "6"}
    with pytest.raises(ValueError, match="`names` has 'z', but the parts are '1'"):
        tj.draw(mechanism, names=["a", "z"])


def double_parallelogram():
    """A shuttle on two frames: eight leaves with long names, and no outlines."""
    spring = tj.Quadratic(np.diag([0.1, 1e6, 1e3]))
    rows = {"outer left": -0.05, "outer right": 0.05, "left": -0.03, "right": 0.03}
    bodies = [tj.Body("ground"), tj.Body("shuttle", (0.0, 0.0, 0.06))]
    hinges = []
    for name, x in rows.items():
        bodies.append(tj.Body(f"{name} bar", (0.0, x, 0.03)))
        lower = f"lower {name}", "ground", f"{name} bar"
        upper = f"upper {name}", f"{name} bar", "shuttle"
        hinges.append(tj.Hinge(*lower, spring, at=(jnp.pi / 2, x, 0.01)))
        hinges.append(tj.Hinge(*upper, spring, at=(jnp.pi / 2, x, 0.05)))
    return tj.Mechanism(bodies, hinges, fixed=["ground"])


def drawn_stage(**settings):
    mechanism = stage.microstage()
    solution = stage.amplification(mechanism).equilibrium
    return tj.draw(mechanism, solution, reactions=True, magnify=80, **settings)


DRAWINGS = {
    "stage": lambda axes: tj.draw(stage.microstage(), axes=axes),
    "reactions": lambda axes: drawn_stage(axes=axes),
    "frames": lambda axes: drawn_stage(axes=axes, frames=True),
    "long names": lambda axes: tj.draw(double_parallelogram(), axes=axes),
}


@pytest.mark.parametrize(
    ("draw", "size"),
    [
        *(("stage", 7.0), ("stage", 3.0), ("reactions", 3.0), ("frames", 3.0)),
        *(("long names", 7.0), ("long names", 4.5)),
    ],
)
def test_labels_do_not_overlap(draw, size):
    """Labels of bodies, hinges and reactions do not overlap, and stay in the axes."""
    figure, axes = plt.subplots(figsize=(size, size), layout="constrained")
    axes.text(0.5, 0.5, "a text of the user", transform=axes.transAxes, ha="center")
    DRAWINGS[draw](axes)
    figure.canvas.draw()
    boxes = [(text.get_text(), text.get_window_extent()) for text in axes.texts]
    assert len(boxes) >= 14
    for (name, box), (other, other_box) in itertools.combinations(boxes, 2):
        assert not box.overlaps(other_box), (name, other)
    frame = axes.get_window_extent()
    for name, box in boxes:
        assert frame.x0 <= box.x0 and box.x1 <= frame.x1, name
        assert frame.y0 <= box.y0 and box.y1 <= frame.y1, name


def test_labels_are_placed_at_the_same_positions_each_time():
    positions = []
    for _ in range(2):
        axes = drawn_stage()
        for _ in range(2):
            axes.figure.canvas.draw()
            labels = [text for text in axes.texts if isinstance(text, Annotation)]
            assert len(labels) == len(axes.texts)
            positions.append([label.xyann for label in labels])
    for other in positions[1:]:
        assert_close(positions[0], other, digits=10)


def arrows(axes, color):
    """Start and tip of each arrow of a color; mm."""
    return [
        np.array(patch._posA_posB)  # pyright: ignore[reportAttributeAccessIssue]
        for patch in axes.patches
        if isinstance(patch, FancyArrowPatch)
        and to_hex(patch.get_edgecolor()) == figure_style.__dict__[color]
    ]


def test_loads_are_drawn_as_arrows_from_their_points_of_application():
    """A follower load rotates with its body. The longest arrow is a fifth of the size."""
    linkage = four_bar.four_bar()
    loads = [
        tj.Load("3", (0.0, 4.0, 0.0), at=(0.02, 0.0)),
        tj.Load("2", (0.0, 0.0, 3.0), follower=True),
    ]
    solution = tj.equilibrium(linkage, loads=loads)
    axes = tj.draw(linkage, solution, loads=loads, names=False)
    constant, follower = arrows(axes, "RED")
    point = se2.act(solution.pose("3"), jnp.array([0.02, 0.0]))
    assert_close(constant[0], 1e3 * np.asarray(point))
    size = 70.0  # from the bottom of the ground link to the top of link 3; mm
    assert_close(constant[1] - constant[0], [0.2 * size, 0.0])
    angle = np.asarray(solution.pose("2"))[0]
    direction = np.array([-np.sin(angle), np.cos(angle)])
    assert_close(follower[1] - follower[0], 0.75 * 0.2 * size * direction)
    assert {text.get_text() for text in axes.texts} == {"4 N", "3 N"}


def test_reactions_are_drawn_in_balance():
    """The reactions on the frame and on the input of the stage are opposite."""
    mechanism = stage.microstage()
    solution = stage.amplification(mechanism).equilibrium
    axes = tj.draw(mechanism, solution, reactions=True, names=False)
    frame, _, pushed = arrows(axes, "GREEN")  # the second is the moment on the frame
    assert_close(frame[1] - frame[0], pushed[0] - pushed[1], digits=6)
    with pytest.raises(ValueError, match="`poses` has no reactions"):
        tj.draw(mechanism, solution.poses, reactions=True)


def test_a_force_of_rounding_size_is_not_drawn_beside_a_moment():
    """Under a moment alone, the reaction is a moment, and its force is a rounding error.

    Forces are compared with moments by the size of the mechanism, 0.07 m: a force of
    1 mN is left out beside a moment of 0.1 N m, and one of 2 mN is drawn.
    """
    linkage = four_bar.four_bar()
    loads = [tj.Load("3", (0.05, 0.0, 0.0))]
    solution = tj.equilibrium(linkage, loads=loads)
    assert 0 < np.abs(np.asarray(solution.reactions)[0, 1:]).max() < 1e-9
    axes = tj.draw(linkage, solution, loads=loads, reactions=True, names=False)
    assert [text.get_text() for text in axes.texts] == 2 * ["50 mN m"]
    assert len(arrows(axes, "GREEN")) == 1
    for force, labels in ((1e-3, {"100 mN m"}), (2e-3, {"100 mN m", "2 mN"})):
        loads = [tj.Load("3", (0.1, force, 0.0))]
        axes = tj.draw(linkage, loads=loads, names=False)
        assert {text.get_text() for text in axes.texts} == labels


def test_a_moment_of_rounding_size_is_not_drawn_beside_a_force():
    linkage = four_bar.four_bar()
    for moment, labels in ((6e-5, {"1 N"}), (8e-5, {"1 N", "80 \N{MICRO SIGN}N m"})):
        loads = [tj.Load("3", (moment, 1.0, 0.0))]
        axes = tj.draw(linkage, loads=loads, names=False)
        assert {text.get_text() for text in axes.texts} == labels


def test_reactions_of_rounding_size_are_not_drawn_under_balanced_loads():
    """Opposite moments cause no reaction. They need not be drawn for the comparison."""
    linkage = four_bar.four_bar()
    loads = [tj.Load("2", (0.05, 0.0, 0.0)), tj.Load("4", (-0.05, 0.0, 0.0))]
    solution = tj.equilibrium(linkage, loads=loads)
    assert 0 < np.abs(solution.reactions).max() < 1e-9
    for drawn_loads in (loads, ()):
        axes = tj.draw(linkage, solution, loads=drawn_loads, reactions=True, names=False)
        assert not arrows(axes, "GREEN")


def test_hinges_are_colored_by_their_energies():
    mechanism = stage.microstage()
    solution = stage.amplification(mechanism).equilibrium
    axes = tj.draw(mechanism, solution, color="energy", names=False)
    bar = axes.figure.axes[1]
    assert bar.get_ylabel() == "energy (µJ)"
    energies = {
        name: float(mechanism.energy_of(name, solution.poses))
        for name in mechanism.hinge_names
    }
    assert_close(sum(energies.values()), solution.energy)
    assert_close(bar.get_ylim()[1], 1e6 * max(energies.values()))
    (hinges,) = (drawn for drawn in axes.collections if len(drawn.get_facecolor()) == 7)
    colors = np.asarray(hinges.get_facecolor())
    brightest = np.argmax(colors[:, :2].sum(axis=1))
    assert "abcdefg"[brightest] == max(energies, key=lambda name: energies[name])
    with pytest.raises(ValueError, match="`color` names the hinge 'h'"):
        tj.draw(mechanism, solution, color={"h": 1.0})


def test_an_animation_is_colored_by_stresses():
    """Of two equal leaves under moments, one has twice the stress of the other."""
    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
    bodies = [tj.Body("wall"), tj.Body("a", (0, 0.1, 0)), tj.Body("b", (0, 0.2, 0))]
    hinges = [
        tj.Hinge(name, "wall", name, leaf, at=(np.pi / 2, x, 0.0))
        for name, x in (("a", 0.1), ("b", 0.2))
    ]
    pair = tj.Mechanism(bodies, hinges, fixed=["wall"])

    def bent(moment):
        loads = [tj.Load("a", moment=moment), tj.Load("b", moment=2 * moment)]
        return tj.equilibrium(pair, loads=loads).poses

    poses = np.stack([np.asarray(bent(moment)) for moment in (0.01, 0.02)])
    animation = tj.animate(pair, poses, color="stress")
    animation._draw_was_started = True  # pyright: ignore[reportAttributeAccessIssue]
    axes, bar = animation._fig.axes  # pyright: ignore[reportAttributeAccessIssue]
    largest = 6 * 0.04 / (10e-3 * 0.5e-3**2)  # Pa
    assert bar.get_ylabel() == "stress (MPa)"
    assert_close(bar.get_ylim(), [0.0, 1e-6 * largest], digits=6)

    def colors(frame):
        animation._func(frame)  # pyright: ignore[reportAttributeAccessIssue]
        return axes.collections[2].get_facecolor()

    (half, whole), (quarter, same) = colors(1), colors(0)
    assert_close(same, half)
    assert not np.allclose(half, whole) and not np.allclose(quarter, half)
    with pytest.raises(ValueError, match="The stress is not known in any hinge"):
        bodies = [tj.Body("a"), tj.Body("b")]
        spring = tj.Hinge("h", "a", "b", tj.Quadratic(np.eye(3)), at=(0.0, 0.0, 0.0))
        tj.draw(tj.Mechanism(bodies, [spring], fixed=["a"]), color="stress")


def test_pins_and_sliders_are_drawn_on_the_displaced_bodies():
    linkage = four_bar.four_bar()
    poses = np.array(linkage.reference)
    poses[2, 1] += 5e-3
    constraints = [
        tj.Pin("pin", "1", "3", at=(0.01, 0.065)),
        tj.Slider("rail", "1", "3", at=(0.0, 0.0, 0.065)),
    ]
    axes = tj.draw(linkage, poses, constraints=constraints, reference=False)
    (pin,) = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert_close(pin.center, [15.0, 65.0])
    rail = [patch for patch in axes.patches if isinstance(patch, Polygon)][-1]
    assert_close(np.asarray(rail.get_xy())[:-1].mean(axis=0), [5.0, 65.0])


def test_frames_of_bodies_and_hinges_can_be_drawn():
    linkage = four_bar.four_bar()
    axes = tj.draw(linkage, frames=True)
    assert len(arrows(axes, "BLUE")) == 2 * 4  # two axes of each body
    assert len(arrows(axes, "BROWN")) == 2 * 2 * 4  # two axes of both frames of a hinge


@pytest.mark.parametrize(
    ("length", "unit"), [(1e-7, "nm"), (1e-2, "mm"), (1.0, "mm"), (30.0, "m")]
)
def test_the_unit_of_the_axes_depends_on_the_size_of_the_mechanism(length, unit):
    spring = tj.Quadratic(np.eye(3))
    bodies = [tj.Body("a"), tj.Body("b", (0.0, length, 0.0))]
    hinge = tj.Hinge("h", "a", "b", spring, at=(0.0, length / 2, 0.0))
    axes = tj.draw(tj.Mechanism(bodies, [hinge], fixed=["a"]))
    assert axes.get_xlabel() == f"x ({unit})"


def test_a_batch_and_a_failed_solution_are_rejected():
    linkage = four_bar.four_bar()
    solution = tj.equilibrium(linkage, loads=[tj.Load("3", (0.05, 0.0, 0.0))])
    solutions = jax.tree.map(lambda value: jnp.asarray(np.stack([value] * 3)), solution)
    with pytest.raises(ValueError, match=r"batch of results, of shape \(3,\)"):
        tj.draw(linkage, solutions)
    with pytest.raises(ValueError, match="not finite"):
        tj.draw(linkage, np.full((4, 3), np.nan))


def test_linear_responses_are_drawn_and_animated_as_their_poses():
    linkage = four_bar.four_bar()
    linear = tj.linearize(linkage, {"3": ["x"]})

    @jax.vmap
    def respond(travel):
        return linear(drives=[tj.Drive("3", x=travel)], throw=False)

    responses = respond(jnp.array([0.0, 1e-3]))
    last = jax.tree.map(lambda values: values[1], responses)
    drawn = polygons(tj.draw(linkage, last, reference=False, names=False))
    expected = polygons(tj.draw(linkage, last.poses, reference=False, names=False))
    animation = tj.animate(linkage, responses)
    collections = animation._func(1)  # pyright: ignore[reportAttributeAccessIssue]
    frames = corners_of(collections)
    # This prevents the warning that it was not rendered.
    animation._draw_was_started = True  # pyright: ignore[reportAttributeAccessIssue]
    for shown in (drawn, frames):
        for corners, other in zip(shown, expected, strict=True):
            np.testing.assert_array_equal(corners, other)


@pytest.mark.slow
def test_a_batch_of_equilibria_is_animated_in_sequence():
    linkage = four_bar.four_bar()
    solutions = jax.vmap(lambda x: tj.equilibrium(linkage, drives=[tj.Drive("3", x=x)]))(
        jnp.linspace(0.0, 5e-3, 4)
    )
    animation = tj.animate(linkage, solutions)
    collections = animation._func(3)  # pyright: ignore[reportAttributeAccessIssue]
    axes = collections[0].axes
    assert axes.get_title() == "4 of 4"
    last = tj.draw(linkage, solutions.poses[3], reference=False, names=False)
    for corners, expected in zip(corners_of(collections), polygons(last), strict=True):
        assert_close(corners, expected)
    # This prevents the warning that it was not rendered.
    animation._draw_was_started = True  # pyright: ignore[reportAttributeAccessIssue]
    solution = tj.equilibrium(linkage, drives=[tj.Drive("3", x=1e-3)])
    with pytest.raises(ValueError, match="one equilibrium"):
        tj.animate(linkage, solution)
    with pytest.raises(ValueError, match="`motion` is a Mechanism, but"):
        tj.animate(linkage, linkage)  # pyright: ignore[reportArgumentType]


def test_a_vibration_is_animated_in_its_mode_shape():
    linkage = four_bar.four_bar()
    vibrations = tj.vibrations(linkage)
    animation = tj.animate(linkage, vibrations, mode=1, frames=8)
    draw_frame = animation._func  # pyright: ignore[reportAttributeAccessIssue]
    centers = [  # of link 2
        corners_of(draw_frame(frame))[1][:-1].mean(axis=0) for frame in (0, 2, 4, 6)
    ]
    animation._draw_was_started = True  # pyright: ignore[reportAttributeAccessIssue]
    shape = np.asarray(vibrations.shapes)[1, 1, 1:]
    amplitude = centers[1] - centers[0]
    assert_close(amplitude / np.linalg.norm(amplitude), shape / np.linalg.norm(shape))
    assert_close(centers[2], centers[0])
    assert_close(centers[3] - centers[0], -amplitude)
    with pytest.raises(ValueError, match="`mode` is 9"):
        tj.animate(linkage, vibrations, mode=9)


def test_contours_show_the_energy_within_its_validity_range():
    """A leaf stores k angle^2 / 2. Poses out of the validity range are blank."""
    alloy = tj.Material(69e9, 0.33)
    leaf = tj.flexures.linear_leaf(
        alloy, length=0.01, thickness=1e-3, width=5e-3, coordinates="twist"
    )
    stiffness = float(leaf.stiffness[0, 0])
    limited = tj.energies.WithValidityRange(
        leaf, rotation=0.2, force=1e9, error=[0.0, 0.0, 0.0]
    )
    panel = tj.plotting.draw_energy(limited, rotation=0.4).axes[0]
    assert panel.get_title() == "energy (mJ)"
    contours = panel.collections[0]
    assert isinstance(contours, ContourSet)

    for rotation in (0.05, 0.1, 0.19):
        energy = 1e3 * stiffness * rotation**2 / 2  # mJ
        (band,) = [
            k
            for k, (low, high) in enumerate(itertools.pairwise(contours.levels))
            if low <= energy < high
        ]
        assert contours.get_paths()[band].contains_point((rotation, 1e-4))
    assert not any(path.contains_point((0.25, 0.0)) for path in contours.get_paths())


def test_outputs_of_a_sweep_are_drawn_over_one_or_two_parameters():
    """A line over one parameter, colors over two; other outputs are rejected."""
    from twistorjax.plotting import draw_sweep

    def study(design):
        energy = tj.solve.Column(design["a"] * design["b"], unit="J")
        return {"energy": energy, "row": jnp.ones(3) * design["a"]}

    grid = tj.Grid({"a": np.linspace(1e-3, 2e-3, 5), "b": np.linspace(1.0, 3.0, 4)})
    table = tj.sweep(study, grid, units={"a": "m"})
    (panel, bar) = draw_sweep(table, ["energy"]).axes
    assert panel.get_ylabel() == "a (mm)" and bar.get_ylabel() == "energy (mJ)"
    (contours,) = (c for c in panel.collections if isinstance(c, ContourSet))
    for level, path in zip(contours.levels, contours.get_paths(), strict=True):
        b, a = np.asarray(path.vertices).T  # linear between the designs of the grid
        np.testing.assert_allclose(a * b, level, rtol=0.05)
    line = draw_sweep(table.isel(b=0), ["energy"]).axes[0].lines[0]
    np.testing.assert_allclose(np.asarray(line.get_xdata()), np.linspace(1.0, 2.0, 5))
    np.testing.assert_allclose(np.asarray(line.get_ydata()), np.linspace(1.0, 2.0, 5))
    rows = tj.sweep(study, {"a": np.linspace(1, 2, 6), "b": np.ones(6)})
    with pytest.raises(ValueError, match="differ in 2 parameters"):
        draw_sweep(rows, ["energy"])
    with pytest.raises(ValueError, match="'row' cannot be drawn"):
        draw_sweep(table, ["row"])


def test_the_outline_of_a_notch_is_no_higher_than_its_bodies():
    """It is as wide as its holes, and cut off where these exceed the bodies."""
    cut = np.asarray(tj.flexures.notch_outline(hole=8e-3, web=0.5e-3, height=5e-3))
    assert_close(np.abs(cut[:, 1]).max(), 2.5e-3)
    assert_close(np.abs(cut[:, 0]).max(), 4e-3)
    on_arc = np.abs(cut[:, 0]) < 3.9e-3
    to_center = np.hypot(cut[:, 0], 4.25e-3 - np.abs(cut[:, 1]))
    np.testing.assert_allclose(to_center[on_arc], 4e-3)
    assert np.sum(on_arc) == 2 * 61


def oscillator(stiffness=800.0, damping=None):
    """A mass of 2 kg on a spring, which resonates at 20 rad/s by default."""
    spring = tj.Quadratic(jnp.eye(3)) * stiffness
    mass = tj.Body("mass", mass=2.0, inertia=1e-3)
    hinge = tj.Hinge("spring", "wall", "mass", spring, at=(0, 0, 0), damping=damping)
    return tj.Mechanism([tj.Body("wall"), mass], [hinge], fixed=["wall"])


@pytest.mark.parametrize("rate", [0.0, 4.0])
def test_the_phase_of_an_oscillator_lags_by_half_a_turn_above_its_resonance(rate):
    damped = oscillator(damping=rate / 800.0 if rate else None)  # a time; s
    rates = np.array([5.0, 19.0, 21.0, 60.0])
    push = tj.Load("mass", force=(3.0, 0.0))
    response = tj.frequency_response(damped, rates / (2 * np.pi), loads=[push])
    size, phase = tj.plotting.draw_frequency_response(response, "mass", "x").axes
    amplitude = 3.0 / (800.0 - 2.0 * rates**2 + 1j * rate * rates)
    assert size.get_ylabel() == "x of mass (mm)"
    assert_close(size.lines[0].get_ydata(), 1e3 * np.abs(amplitude))
    lag = -np.degrees(np.arctan2(rate * rates, 800.0 - 2.0 * rates**2))
    assert_close(phase.lines[0].get_ydata(), lag)


def test_a_fit_is_drawn_with_its_readings_and_their_differences():
    sensor = tj.identification.BodySensor("mass", "x", standard_deviation=1e-5)
    pulls = [[tj.Load("mass", force=(force, 0.0))] for force in (1.0, 2.0, 3.0)]
    test = tj.identification.StaticTest(pulls, [sensor])
    readings = np.array([1.01e-3, np.nan, 2.99e-3])
    found = tj.identify(
        lambda parameters: oscillator(parameters["stiffness"]),
        {"stiffness": tj.Parameter(900.0, "N/m", lower=0)},
        [test.measurement(readings[:, None])],
    )
    above, below = tj.plotting.draw_fit(found).axes
    # least squares of readings that are proportional to the force
    slope = (1.01 * 1 + 2.99 * 3) / (1 + 9)
    predicted = next(line for line in above.lines if line.get_label() == "predicted")
    np.testing.assert_allclose(
        np.asarray(predicted.get_ydata()), slope * np.array([1, np.nan, 3])
    )
    differences = (slope * np.array([1, 3]) - [1.01, 2.99]) / 1e-2
    np.testing.assert_allclose(
        np.asarray(below.lines[0].get_ydata()), differences, atol=1e-5
    )
    assert above.get_ylabel() == "mass.x (mm)"


def test_hinges_of_infinite_life_are_below_the_line_of_goodman():
    steel = tj.Material(
        modulus=210e9, poisson=0.3, ultimate_strength=800e6, endurance_limit=300e6
    )
    leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
    hinges = [tj.Hinge(n, "wall", n + " end", leaf, at=(0, 0, 0)) for n in ("a", "b")]
    bodies = [tj.Body("wall"), tj.Body("a end"), tj.Body("b end")]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["wall"])
    moments = 0.1, 0.25  # N m: stresses 6 M / (w t^2) of 240 MPa and 600 MPa
    loads = [tj.Load(f"{n} end", moment=m) for n, m in zip("ab", moments, strict=True)]
    bent = tj.equilibrium(mechanism, loads=loads)
    axes = tj.plotting.draw_fatigue(tj.fatigue(mechanism, [mechanism.reference, bent]))
    points = {line.get_label(): np.ravel(line.get_xydata()) for line in axes.lines}
    np.testing.assert_allclose(points["infinite life"], [120 / 800, 120 / 300], rtol=1e-6)
    np.testing.assert_allclose(points["finite life"], [300 / 800, 300 / 300], rtol=1e-6)


def test_hinges_of_unknown_stress_are_gray():
    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=20e-3, thickness=0.5e-3, width=10e-3)
    square = [(-2e-3, -2e-3), (2e-3, -2e-3), (2e-3, 2e-3), (-2e-3, 2e-3)]
    spring = tj.Quadratic(jnp.diag(jnp.array([1.0, 1e4, 1e4])))
    hinges = [
        tj.Hinge("leaf", "wall", "block", leaf, at=(0, 10e-3, 0)),
        tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0), outline=square),
    ]
    bodies = [tj.Body("wall"), tj.Body("block")]
    mechanism = tj.Mechanism(bodies, hinges, fixed=["wall"])
    solution = tj.equilibrium(mechanism, loads=[tj.Load("block", force=(0.0, 1.0))])
    axes = tj.draw(mechanism, solution, color="stress", names=False)
    fills = [
        to_hex(tuple(map(float, color)))  # pyright: ignore
        for part in axes.collections
        if isinstance(part, PolyCollection) and len(part.get_paths()) == 2
        for color in part.get_facecolor()
    ]
    assert fills[-1] == figure_style.GRAY and fills[-2] != figure_style.GRAY


@pytest.mark.untyped
def test_wrong_arguments_of_drawings_are_explained():
    mechanism = oscillator()
    found = tj.equilibrium(mechanism)
    with pytest.raises(ValueError, match="`mechanism` is a Equilibrium, but must be a"):
        tj.draw(found, mechanism)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"Use `animate\(mechanism, vibrations"):
        tj.draw(mechanism, tj.vibrations(mechanism))  # pyright: ignore[reportArgumentType]


def test_rounding_errors_are_not_drawn_as_contours():
    spring = tj.Quadratic(np.diag([0.1, 1e6, 1e6]), "twist")
    figure = tj.plotting.draw_energy(spring)
    panel = figure.axes[3]
    assert panel.get_title() == "axial displacement (m)"
    contours: list[Any] = [c for c in panel.collections if isinstance(c, ContourSet)]
    assert len(contours) == 2 and all(each.zmax == 0 for each in contours)


def test_the_names_of_crossing_leaves_are_at_their_own_ends():
    steel = tj.Material(modulus=210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=40e-3, thickness=0.5e-3, width=10e-3)
    angles = {"right": np.pi / 4, "left": 3 * np.pi / 4}
    hinges = [
        tj.Hinge(name, "base", "lever", leaf, at=(angle, 0.0, 0.0))
        for name, angle in angles.items()
    ]
    bodies = [tj.Body("base", (0.0, 0.0, -0.02)), tj.Body("lever", (0.0, 0.0, 0.02))]
    axes = tj.draw(tj.Mechanism(bodies, hinges, fixed=["base"]))
    texts: list[Any] = list(axes.texts)
    anchors = {text.get_text(): text.xy for text in texts}  # mm
    for name, angle in angles.items():
        assert_close(anchors[name], 12 * np.array([np.cos(angle), np.sin(angle)]))
