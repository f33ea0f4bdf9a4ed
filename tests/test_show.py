"""Pictures, as far as a program can look at them."""

import itertools

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest


mpl.use("agg")

import matplotlib.pyplot as plt
from helpers import assert_close
from matplotlib.colors import to_hex
from matplotlib.patches import Circle, FancyArrowPatch, Polygon

import twistorjax as tj
from twistorjax.examples import four_bar, stage
from twistorjax.plotting import canvas


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def polygons(axes):
    return [patch for patch in axes.patches if isinstance(patch, Polygon)]


def test_a_body_is_drawn_where_it_is_in_millimetres():
    mechanism = stage.microstage()
    poses = mechanism.reference.at[5].add(jnp.array([0.0, 1e-3, 0.0]))
    axes = tj.draw(mechanism, poses, ghost=False, magnify=2.0)
    drawn = polygons(axes)[5].get_xy()[:-1]
    outline = np.asarray(mechanism.outlines[5] + mechanism.reference[5, 1:][None])
    assert_close(drawn, 1e3 * outline + np.array([2.0, 0.0]))
    assert "magnified 2 times" in axes.get_title()


def test_a_hinge_keeps_to_both_bodies():
    """The ends of a neck move with the bodies that it joins."""
    mechanism = stage.microstage()
    moved = stage.amplify(mechanism).equilibrium
    axes = tj.draw(mechanism, moved.poses, ghost=False, magnify=80.0)
    neck = polygons(axes)[len(mechanism.names)].get_xy()[:-1]  # hinge a: bodies 2 and 6
    outline = np.asarray(mechanism.hinge_outlines[0])
    for end, name in ((outline[:, 0].argmin(), "2"), (outline[:, 0].argmax(), "6")):
        solution = mechanism.reference[mechanism.index(name)]
        corner = mechanism.at[0, 1:] + outline[end]
        pose = solution + 80 * moved.displacement(name)
        expected = tj.geometry.se2.act(pose, corner - solution[1:])
        assert_close(neck[end], 1e3 * expected, digits=10)


def test_the_shape_at_rest_stays_as_a_ghost():
    mechanism = stage.microstage()
    moved = stage.amplify(mechanism).equilibrium
    with_ghost = tj.draw(mechanism, moved.poses)
    without = tj.draw(mechanism, moved.poses, ghost=False)
    assert len(polygons(with_ghost)) == len(polygons(without)) + len(mechanism.names)


def test_bodies_and_hinges_without_outlines_are_drawn_too():
    spring = tj.Quadratic(jnp.eye(3))
    mechanism = tj.Mechanism(
        [tj.Body("a"), tj.Body("b", (0.0, 1.0, 0.0))],
        [tj.Hinge("h", "a", "b", spring, at=(0.0, 0.5, 0.0))],
        fixed=["a"],
    )
    axes = tj.draw(mechanism)
    assert len(polygons(axes)) == 3  # two spokes and a dot
    assert {text.get_text() for text in axes.texts} == {"a", "b", "h"}


def test_names_can_be_left_out():
    assert not tj.draw(stage.microstage(), names=False).texts


def arrows(axes, color):
    """Where arrows of a colour start and end; mm."""
    return [
        np.array(patch._posA_posB)
        for patch in axes.patches
        if isinstance(patch, FancyArrowPatch)
        and to_hex(patch.get_edgecolor()) == canvas.__dict__[color]
    ]


def test_loads_are_arrows_from_where_they_act():
    """One that follows its body turns with it; the longest is a fifth of the size."""
    linkage = four_bar.four_bar()
    loads = [
        tj.Load("3", (0.0, 4.0, 0.0), at=(0.02, 0.0)),
        tj.Load("2", (0.0, 0.0, 3.0), follower=True),
    ]
    solution = tj.equilibrium(linkage, loads=loads)
    axes = tj.draw(linkage, solution, loads=loads, names=False)
    far, follower = arrows(axes, "RED")
    assert_close(
        far[0], 1e3 * tj.geometry.se2.act(solution.pose("3"), jnp.array([0.02, 0.0]))
    )
    size = 70.0  # from below the ground link to above the top one; mm
    assert_close(far[1] - far[0], [0.2 * size, 0.0])
    angle = float(solution.pose("2")[0])
    along = np.array([-np.sin(angle), np.cos(angle)])
    assert_close(follower[1] - follower[0], 0.75 * 0.2 * size * along)
    assert {text.get_text() for text in axes.texts} == {"4 N", "3 N"}


def test_reactions_balance_in_the_picture():
    """The stage's frame receives what its input does, the other way round."""
    mechanism = stage.microstage()
    moved = stage.amplify(mechanism).equilibrium
    axes = tj.draw(mechanism, moved, reactions=True, names=False)
    frame, _, pushed = arrows(axes, "GREEN")  # and the moment on the frame
    assert_close(frame[1] - frame[0], pushed[0] - pushed[1], digits=6)
    with pytest.raises(ValueError, match="told by an equilibrium or a motion"):
        tj.draw(mechanism, moved.poses, reactions=True)


def test_hinges_are_coloured_by_what_they_store():
    mechanism = stage.microstage()
    moved = stage.amplify(mechanism).equilibrium
    axes = tj.draw(mechanism, moved, color="energy", names=False)
    bar = axes.figure.axes[1]
    assert bar.get_ylabel() == "energy (µJ)"
    stored = {
        name: mechanism.hinge_assembly.energy_of(k)(
            mechanism.displacement_of(name, moved.poses)
        )
        for k, name in enumerate(mechanism.hinge_names)
    }
    assert_close(sum(stored.values()), moved.energy)
    assert_close(bar.get_ylim()[1], 1e6 * max(stored.values()))
    necks = polygons(axes)[-7:]
    brightest = max(range(7), key=lambda k: sum(necks[k].get_facecolor()[:2]))
    assert "abcdefg"[brightest] == max(stored, key=stored.get)
    with pytest.raises(ValueError, match="`color` names the hinge 'h'"):
        tj.draw(mechanism, moved, color={"h": 1.0})


def test_pins_and_sliders_are_where_their_bodies_carry_them():
    linkage = four_bar.four_bar()
    poses = linkage.reference.at[2].add(jnp.array([0.0, 5e-3, 0.0]))
    joints = [
        tj.Pin("pin", "1", "3", at=(0.01, 0.065)),
        tj.Slider("rail", "1", "3", at=(0.0, 0.0, 0.065)),
    ]
    axes = tj.draw(linkage, poses, constraints=joints, ghost=False)
    (pin,) = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert_close(pin.center, [15.0, 65.0])
    assert_close(polygons(axes)[-1].get_xy()[:-1].mean(axis=0), [5.0, 65.0])


def test_frames_are_shown_on_request():
    linkage = four_bar.four_bar()
    axes = tj.draw(linkage, frames=True)
    assert len(arrows(axes, "BLUE")) == 2 * 4  # two axes a body
    assert len(arrows(axes, "ORANGE")) == 2 * 2 * 4  # and of both ports of a hinge


@pytest.mark.parametrize(
    ("count", "word"), [(1e-7, "nm"), (1e-2, "mm"), (1.0, "mm"), (30.0, "m")]
)
def test_axes_have_units_that_fit(count, word):
    spring = tj.Quadratic(jnp.eye(3))
    bodies = [tj.Body("a"), tj.Body("b", (0.0, count, 0.0))]
    hinge = tj.Hinge("h", "a", "b", spring, at=(0.0, count / 2, 0.0))
    axes = tj.draw(tj.Mechanism(bodies, [hinge], fixed=["a"]))
    assert axes.get_xlabel() == f"x ({word})"


def test_a_batch_or_no_answer_is_not_drawn():
    linkage = four_bar.four_bar()
    many = jax.vmap(lambda x: tj.equilibrium(linkage, drives=[tj.Drive("3", x=x)]))(
        jnp.linspace(0.0, 1e-3, 3)
    )
    with pytest.raises(ValueError, match=r"batch of answers, of shape \(3,\)"):
        tj.draw(linkage, many)
    with pytest.raises(ValueError, match="not finite"):
        tj.draw(linkage, linkage.reference * jnp.nan)


def test_a_path_of_equilibria_is_a_film():
    linkage = four_bar.four_bar()
    many = jax.vmap(lambda x: tj.equilibrium(linkage, drives=[tj.Drive("3", x=x)]))(
        jnp.linspace(0.0, 5e-3, 4)
    )
    film = tj.animate(linkage, many)
    patches = film._func(3)
    axes = patches[0].axes
    assert axes.get_title() == "4 of 4"
    last = tj.draw(linkage, many.poses[3], ghost=False, names=False)
    for shown, drawn in zip(patches, polygons(last), strict=True):
        assert_close(shown.get_xy(), drawn.get_xy())
    film._draw_was_started = True  # never drawn, on purpose
    one = tj.equilibrium(linkage, drives=[tj.Drive("3", x=1e-3)])
    with pytest.raises(ValueError, match="one equilibrium"):
        tj.animate(linkage, one)


def test_a_vibration_swings_in_its_shape():
    linkage = four_bar.four_bar()
    found = tj.vibrations(linkage)
    film = tj.animate(linkage, found, mode=1, frames=8)
    links = [
        film._func(frame)[1].get_xy()[:-1].mean(axis=0) for frame in (0, 2, 4, 6)
    ]  # of link 2
    film._draw_was_started = True
    moved = found.shapes[1, 1, 1:]
    swung = links[1] - links[0]
    assert_close(swung / np.linalg.norm(swung), moved / jnp.linalg.norm(moved))
    assert_close(links[2], links[0])
    assert_close(links[3] - links[0], -swung)
    with pytest.raises(ValueError, match="`mode` is 9"):
        tj.animate(linkage, found, mode=9)


def test_a_landscape_shows_what_is_stored_and_where_it_is_known():
    """A leaf stores half k times its turn squared; beyond its range, white."""
    alloy = tj.Material(69e9, 0.33)
    blade = tj.flexures.leaf(
        alloy, length=0.01, thickness=1e-3, width=5e-3, coordinates="twist"
    )
    bending = float(blade.stiffness[0, 0])
    sure = tj.energies.WithValidityRange(
        blade, turn=0.2, force=1e9, error=[0.0, 0.0, 0.0]
    )
    panel = tj.plotting.draw_energy(sure, turn=0.4).axes[0]
    assert panel.get_title() == "energy (mJ)"
    levels = panel.collections[0]

    for turn in (0.05, 0.1, 0.19):
        stored = 1e3 * bending * turn**2 / 2  # mJ
        (step,) = [
            k
            for k, (low, high) in enumerate(itertools.pairwise(levels.levels))
            if low <= stored < high
        ]
        assert levels.get_paths()[step].contains_point((turn, 1e-4))
    assert not any(path.contains_point((0.25, 0.0)) for path in levels.get_paths())


def test_answers_of_a_sweep_are_drawn_over_their_parameters():
    """A line over one parameter, colours over two; what cannot be drawn is refused."""
    from twistorjax.plotting.charts import chart

    def study(design):
        energy = tj.solve.Column(design["a"] * design["b"], unit="J")
        return {"energy": energy, "whole": jnp.ones(3) * design["a"]}

    grid = tj.Grid({"a": np.linspace(1e-3, 2e-3, 5), "b": np.linspace(1.0, 3.0, 4)})
    table = tj.sweep(study, grid, units={"a": "m"})
    (panel, bar) = chart(table, ["energy"]).axes
    assert panel.get_ylabel() == "a (mm)" and bar.get_ylabel() == "energy (mJ)"
    line = chart(table.isel(b=0), ["energy"]).axes[0].lines[0]
    np.testing.assert_allclose(line.get_xdata(), np.linspace(1.0, 2.0, 5))
    np.testing.assert_allclose(line.get_ydata(), np.linspace(1.0, 2.0, 5))
    rows = tj.sweep(study, {"a": np.linspace(1, 2, 6), "b": np.ones(6)})
    with pytest.raises(ValueError, match="differ in 2 parameters"):
        chart(rows, ["energy"])
    with pytest.raises(ValueError, match="'whole' cannot be drawn"):
        chart(table, ["whole"])


def test_a_neck_is_no_higher_than_its_bodies():
    """It ends as wide as its holes, flat where these reach beyond the bodies."""
    plain = tj.flexures.notch_outline(hole=8e-3, web=0.5e-3)
    cut = tj.flexures.notch_outline(hole=8e-3, web=0.5e-3, height=5e-3)
    assert_close(jnp.abs(cut[:, 1]).max(), 2.5e-3)
    assert_close(jnp.abs(cut[:, 0]).max(), 4e-3)
    inside = np.abs(plain[:, 1]) < 2.5e-3
    np.testing.assert_array_equal(cut[inside], plain[inside])
