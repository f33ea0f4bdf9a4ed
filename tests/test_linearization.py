"""Linearization against equilibria and their derivatives."""

import jax
import numpy as np
import pytest
from helpers import assert_close
from statics_helpers import block_on_spring, cantilever

import twistorjax as tj
from twistorjax.examples import stage


def test_linearization_is_the_limit_of_small_loads():
    mechanism = stage.microstage()
    linearization = tj.linearize(mechanism, {"6": ["x"]})
    loads, drives = [tj.Load("4", (1e-7, 1e-4, 2e-4))], [tj.Drive("6", x=1e-11)]
    linear = linearization(loads=loads, drives=drives)
    exact = tj.equilibrium(mechanism, loads=loads, drives=drives)
    for quantity in ("displacements", "reactions"):
        expected = np.asarray(getattr(exact, quantity))
        actual = np.asarray(getattr(linear, quantity))
        scale = np.abs(expected).max(axis=0)
        assert_close(actual / scale, expected / scale, digits=5)
    ratio = np.asarray(linear.energy) / np.asarray(exact.energy)
    assert_close(ratio, 1.0, digits=5)


def test_linearization_about_a_loaded_equilibrium_is_its_derivative():
    """The stiffness of the load itself is included."""
    mechanism = cantilever(5)
    loads = [tj.Load("5", force=(-1.0, 1.5), at=(0.05, 0.1))]

    def solve(force):
        additional = tj.Load("5", force=(0.0, force))
        solution = tj.equilibrium(mechanism, loads=[*loads, additional], throw=False)
        return (solution.displacements, solution.reactions), solution.poses

    differentiate = jax.jit(jax.jacfwd(solve, has_aux=True))
    (displacements, reactions), poses = differentiate(0.0)
    linearization = tj.linearize(mechanism, about=poses, loads=loads)
    change = linearization(loads=[tj.Load("5", force=(0.0, 1.0))])
    assert_close(change.displacements, displacements, digits=8)
    assert_close(change.reactions, reactions, digits=7)


def test_linearization_needs_the_drives_for_which_it_was_made():
    linearization = tj.linearize(stage.microstage(), {"6": ["x"]})
    assert repr(linearization).startswith("linearization of: Mechanism of ")
    message = r"prescribes nothing, but this map .* for x of '6'"
    with pytest.raises(ValueError, match=message):
        linearization(loads=[tj.Load("4", force=(1.0, 0.0))])


@pytest.mark.parametrize(
    ("prescribed", "message"),
    [
        ({"anvil": ["x"]}, "`prescribed` names the body 'anvil', but the bodies are"),
        ({"block": ["X"]}, "`prescribed` of the body 'block' names the coordinate 'X'"),
        (["wall"], "`prescribed` names angle of 'wall' and x of 'wall'.*fixed coord"),
    ],
)
def test_coordinates_that_cannot_be_prescribed_are_reported(prescribed, message):
    with pytest.raises(ValueError, match=message):
        tj.linearize(block_on_spring(np.eye(3)), prescribed)


def test_linearization_of_a_mechanism_without_stiffness_is_an_error():
    linearization = tj.linearize(block_on_spring(np.diag([1.0, 0.0, 1.0])))
    with pytest.raises(RuntimeError, match="without an increase of the energy"):
        linearization()
