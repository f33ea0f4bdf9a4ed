"""Equilibria that do not exist, and invalid arguments of statics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from statics_helpers import block_on_spring, cantilever

import twistorjax as tj
from twistorjax.examples.truss import von_mises_truss
from twistorjax.results.codes import RESULTS
from twistorjax.solve.statics.errors import finish_equilibrium


def test_error_of_a_batch_names_the_failed_design():
    def solve(k):
        stiffness = np.diag([1.0, 0.0, 1.0]) + k * np.diag([0.0, 1.0, 0.0])
        return tj.equilibrium(block_on_spring(stiffness), throw=False)

    batch = jax.jit(jax.vmap(solve))(np.array([4.0, 0.0, 3.0]))
    with pytest.raises(RuntimeError, match="index 1 of the batch"):
        finish_equilibrium(batch, throw=True)
    assert repr(batch.result) == "RESULTS<['successful' 'unstable' 'successful']>"
    assert repr(batch) == "3 equilibria, of shape (3,): 2 successful, 1 unstable"


def test_a_result_prints_its_name():
    """Equinox prints the message of a result, which is empty after a success."""
    spring = block_on_spring(np.eye(3))
    solution = tj.equilibrium(spring)
    assert str(solution.result) == f"{RESULTS.successful}" == "RESULTS<successful>"
    failed = tj.equilibrium(spring, loads=[tj.Load("block", moment=1.25)], throw=False)
    assert repr(failed.result) == "RESULTS<no_equilibrium>"
    shapes = jax.eval_shape(lambda: tj.equilibrium(spring))
    assert repr(shapes.result) == "RESULTS<unknown>"


@pytest.mark.parametrize("traced", [False, True])
def test_block_without_stiffness_in_one_direction_has_no_equilibrium(traced):
    def solve():
        return tj.equilibrium(block_on_spring(np.diag([1.0, 0.0, 1.0]))).poses

    with pytest.raises(Exception, match="without an increase of the energy"):
        (jax.jit(solve) if traced else solve)()


def test_largest_moment_of_a_twistor_spring_is_its_stiffness():
    """The moment is k sin(angle), at most k at 90 degrees."""
    mechanism, load = block_on_spring(np.eye(3)), tj.Load("block", moment=1.25)
    with pytest.raises(RuntimeError, match="No equilibrium at the full loads") as error:
        tj.equilibrium(mechanism, loads=[load])
    assert "Check also the units" in str(error.value)
    assert "Misfits" not in str(error.value)
    spring = tj.Hinge("h", "wall", "block", tj.Quadratic(np.eye(3)), (0.0, 0.0, 0.0),
                      misfit=(0.1, 0.0, 0.0))  # fmt: skip
    bodies = [tj.Body("wall"), tj.Body("block")]
    misfit = tj.Mechanism(bodies, [spring], fixed=["wall"])
    with pytest.raises(RuntimeError, match="Misfits are applied in the same incr"):
        tj.equilibrium(misfit, loads=[load])
    solution = tj.equilibrium(mechanism, loads=[load], throw=False)
    assert_close(solution.fraction, 0.8, digits=3)
    assert_close(np.asarray(solution.reached)[1, 0], np.pi / 2, digits=1)


@pytest.mark.slow
def test_too_small_number_of_steps_is_an_error():
    load = tj.Load("10", force=(0.0, 5.0))
    with pytest.raises(RuntimeError, match="number of Newton steps was reached"):
        tj.equilibrium(cantilever(10), loads=[load], max_steps=5)


def test_single_precision_is_an_error():
    with jax.enable_x64(False):
        with pytest.raises(ValueError, match=r"twistorjax\.configure"):
            tj.equilibrium(block_on_spring(np.eye(3)))
        with pytest.raises(ValueError, match=r"twistorjax\.configure"):
            tj.linearize(block_on_spring(np.eye(3)))


def test_parts_in_single_precision_are_an_error():
    """They were created before `tj.configure()`."""
    with jax.enable_x64(False):
        spring = tj.Quadratic(np.eye(3))
    bodies = [tj.Body("wall"), tj.Body("block")]
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="hinge 'spring' has numbers of type float32"):
        tj.Mechanism(bodies, [hinge], fixed=["wall"])


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"loads": [tj.Load("anvil", force=(1.0, 0.0))]},
            r"`loads\[0\]` names the body 'anvil', but the bodies are 'wall', 'block'",
        ),
        (
            {"drives": [tj.Drive("anvil", x=1.0)]},
            r"`drives\[0\]` names the body 'anvil'",
        ),
        ({"tolerance": 0.0}, "`tolerance` is 0.0 and `max_steps` is 400, but"),
        ({"max_steps": 0}, "`max_steps` is 0, but"),
        ({"start": jnp.zeros((3, 3))}, r"`start` has shape \(3, 3\), but a mechanism"),
        (
            {"loads": tj.Load("block", force=(1, 0))},
            "`loads` is one Load: put it in a list",
        ),
        (
            {"loads": [tj.Drive("block", x=1.0)]},
            r"`loads\[0\]` is a Drive, but must be a Load",
        ),
        (
            {"drives": [tj.Drive("wall", x=1.0)]},
            r"`drives\[0\]` prescribes the x of 'wall', which is fixed already",
        ),
        (
            {"drives": [tj.Drive("block", x=1.0), tj.Drive("block", x=1.0)]},
            r"`drives\[1\]` prescribes the x of 'block', which is prescribed already",
        ),
    ],
)
def test_invalid_arguments_of_equilibrium_are_reported(arguments, message):
    with pytest.raises(ValueError, match=message):
        tj.equilibrium(block_on_spring(np.eye(3)), **arguments)


@pytest.mark.parametrize(
    ("create", "message"),
    [
        (lambda: tj.Drive("b"), "The drive of 'b' prescribes no coordinate"),
        (
            lambda: tj.Drive("b", x=np.nan),
            "`x` of the drive of 'b' is nan, but must be",
        ),
        (
            lambda: tj.Load("b", (1.0, 2.0)),
            r"`wrench` of the load on 'b' has shape \(2,\)",
        ),
        (
            lambda: tj.Load("b", (1.0, 2.0, np.inf)),
            "`wrench` of the load on 'b' has .*inf.* at index ., but must be finite",
        ),
        (
            lambda: tj.Load("b", (1.0, 2.0, 3.0), at=(0.0,)),
            r"`at` of the load on 'b' has shape \(1,\), but must be \(x, y\)",
        ),
    ],
)
def test_invalid_loads_and_drives_are_reported(create, message):
    with pytest.raises(ValueError, match=message):
        create()


def test_unknown_body_is_reported():
    solution = tj.equilibrium(block_on_spring(np.eye(3)))
    with pytest.raises(ValueError, match="`body` is 'anvil', but the bodies are 'wall'"):
        solution.displacement("anvil")


def test_a_failure_has_the_same_message_under_a_gradient():
    def sinking(force):
        loads = [tj.Load("apex", force=(0.0, -force))]
        return tj.equilibrium(von_mises_truss(), loads=loads).displacement("apex")[2]

    for function in (sinking, jax.grad(sinking)):
        with pytest.raises(RuntimeError, match="There is a limit point at the fraction"):
            function(40.0)


def test_loads_on_fixed_bodies_only_are_noticed():
    spring = tj.Quadratic(np.diag([1.0, 100.0, 100.0]))
    hinge = tj.Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
    bodies = [tj.Body("wall"), tj.Body("block")]
    mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
    on_wall, on_block = (tj.Load(name, force=(5.0, 0.0)) for name in ("wall", "block"))
    with pytest.warns(UserWarning, match="All loads act on fixed bodies"):
        tj.equilibrium(mechanism, loads=[on_wall])
    tj.equilibrium(mechanism, loads=[on_wall, on_block])
