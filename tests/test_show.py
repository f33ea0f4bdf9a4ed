"""Pictures, as far as a program can look at them."""

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest


mpl.use("agg")

import matplotlib.pyplot as plt
from helpers import assert_close
from matplotlib.patches import Polygon

import twistorjax as tj
from twistorjax.cases import stage


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def polygons(axes):
    return [patch for patch in axes.patches if isinstance(patch, Polygon)]


def test_a_body_is_drawn_where_it_is_in_millimetres():
    mechanism = stage.microstage()
    poses = mechanism.rest.at[5].add(jnp.array([0.0, 1e-3, 0.0]))
    axes = tj.draw(mechanism, poses, ghost=False, magnify=2.0)
    drawn = polygons(axes)[5].get_xy()[:-1]
    outline = np.asarray(mechanism.outlines[5] + mechanism.rest[5, 1:][None])
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
        rest = mechanism.rest[mechanism.index(name)]
        corner = mechanism.at[0, 1:] + outline[end]
        pose = rest + 80 * moved.displacement(name)
        expected = tj.se2.act(pose, corner - rest[1:])
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
        held=["a"],
    )
    axes = tj.draw(mechanism)
    assert len(polygons(axes)) == 3  # two spokes and a dot
    assert {text.get_text() for text in axes.texts} == {"a", "b", "h"}


def test_names_can_be_left_out():
    assert not tj.draw(stage.microstage(), names=False).texts


def test_answers_of_a_sweep_are_drawn_over_their_parameters():
    """A line over one parameter, colours over two; what cannot be drawn is refused."""
    from twistorjax.show.charts import chart

    def study(design):
        energy = tj.Column(design["a"] * design["b"], unit="J")
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
