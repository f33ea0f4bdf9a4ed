"""Derivatives and batches of equilibria."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, mostly_slow, some_stiffness, with_value
from statics_helpers import block_on_spring, cantilever

import twistorjax as tj


@pytest.mark.release
def test_derivatives_by_a_stiffness_are_those_of_the_closed_form():
    def displacement(k):
        stiffness = jnp.diag(jnp.stack([jnp.ones(()), k, jnp.ones(())]))
        load = tj.Load("block", force=(2.0, 0.0))
        solution = tj.equilibrium(block_on_spring(stiffness), loads=[load])
        return solution.displacement("block")[1]

    k = jnp.array(8.0)
    for derivative in (jax.grad, jax.jacfwd, lambda f: jax.grad(jax.jit(f))):
        assert_close(derivative(displacement)(k), -2.0 / k**2)
    assert_close(jax.jit(jax.grad(jax.grad(displacement)))(k), 4.0 / k**3)


@pytest.mark.parametrize("derivative", mostly_slow([jax.jacrev, jax.jacfwd]))
def test_derivatives_with_a_slider_are_those_of_the_closed_form(derivative):
    """The slider along y leaves one spring."""

    def displacements(k):
        stiffness = jnp.diag(jnp.stack([jnp.ones(()), jnp.ones(()), k]))
        slider = tj.Slider("slider", "wall", "block", at=(jnp.pi / 2, 0.0, 0.0))
        load = tj.Load("block", force=(3.0, 2.0))
        return tj.equilibrium(
            block_on_spring(stiffness), loads=[load], constraints=[slider], throw=False
        ).displacement("block")

    k = 8.0
    first = derivative(with_value(displacements), has_aux=True)
    second = jax.jit(jax.jacfwd(with_value(first), has_aux=True))
    (changes, _), (slopes, found) = second(k)
    assert_close(found, [0.0, 0.0, 2.0 / k])
    assert_close(slopes, [0.0, 0.0, -2.0 / k**2])
    assert_close(changes, [0.0, 0.0, 4.0 / k**3])


PARAMETERS = np.array([2.0, 0.4, 0.7, 0.3])


def chain(parameters):
    """Return a result of a bent chain whose every argument depends on the parameters."""
    stiffness, force, angle, position = parameters
    spring = tj.Quadratic(some_stiffness(3) * stiffness)
    poses = [(0.0, 0.0, 0.0), (0.3, 1.0, position), (0.6, 1.8, 0.5)]
    bodies = [tj.Body(str(k), pose) for k, pose in enumerate(poses)]
    at = jnp.stack([jnp.array(0.1), position, position])
    hinges = [
        tj.Hinge("h", "0", "1", spring, at),
        tj.Hinge("i", "1", "2", spring, (0.2, 1.5, 0.2)),
    ]
    solution = tj.equilibrium(
        tj.Mechanism(bodies, hinges, fixed=["0"]),
        loads=[
            tj.Load("1", (0.1, force, 0.5), at=(0.2, 0.1)),
            tj.Load("1", force=(0.0, force), at=(0.1, 0.2), follower=True),
        ],
        drives=[tj.Drive("2", angle=angle)],
        throw=False,
    )
    weights = np.random.default_rng(1).normal(size=(3, 3))
    return (
        jnp.vdot(weights, solution.poses)
        + jnp.vdot(weights, solution.reactions)
        + solution.energy
    )


@jax.jit
def first_derivatives(parameters):
    """Return the result, and its gradient in reverse and in forward mode."""
    return *jax.value_and_grad(chain)(parameters), jax.jacfwd(chain)(parameters)


def central_differences(function, step=1e-5):
    after, before = (
        np.array([function(PARAMETERS + side * e) for e in np.eye(4)])
        for side in (step, -step)
    )
    return (after - before) / (2 * step)


def test_derivatives_by_all_arguments_agree_with_differences():
    _, reverse, forward = first_derivatives(PARAMETERS)
    differences = central_differences(lambda at: first_derivatives(at)[0])
    assert_close(reverse, differences, digits=6)
    assert_close(forward, reverse, digits=9)


@pytest.mark.slow
def test_second_derivatives_agree_with_differences_of_first_ones():
    hessian = jax.jit(jax.jacfwd(jax.grad(chain)))(PARAMETERS)
    differences = central_differences(lambda at: first_derivatives(at)[1])
    assert_close(hessian, differences, digits=5)


def test_a_traced_start_that_displaces_a_fixed_body_fails():
    """A known one raises an error. At the reference, the start changes nothing."""
    mechanism = cantilever(1)

    def tip(shift):
        start = mechanism.reference.at[0, 2].add(shift)
        load = tj.Load("1", force=(0.0, 0.5))
        solution = tj.equilibrium(mechanism, loads=[load], start=start, throw=False)
        return solution.displacement("1")[2], solution.result

    at_reference, rates = jax.jvp(tip, (0.0,), (1.0,))
    assert tj.result_names(at_reference[1]) == "successful" and rates[0] == 0.0
    displaced = jax.jit(tip)(1e-3)
    assert tj.result_names(displaced[1]) == "not_finite" and jnp.isnan(displaced[0])


def solve_block(k, force: float | jax.Array = 2.0):
    """Solve for a block on a spring of stiffness k, without raising errors."""
    stiffness = jnp.diag(jnp.stack([jnp.ones(()), k, jnp.ones(())]))
    load = tj.Load("block", force=(force, 0.0))
    return tj.equilibrium(block_on_spring(stiffness), loads=[load], throw=False)


@pytest.mark.slow
def test_gradient_of_a_batch_is_zero_for_a_failed_design():
    def displacement(k):
        return solve_block(k).displacement("block")[1]

    gradients = jax.vmap(jax.grad(displacement))(jnp.array([4.0, 0.0]))
    assert_close(gradients, jnp.array([-2 / 16, 0.0]))


@pytest.mark.slow
def test_failed_design_is_nan_and_can_be_masked_in_a_gradient():
    """A derivative of NaN instead of zero would make the gradient of the sum NaN."""

    def total(stiffness):
        def solve(factor):
            return solve_block(factor * stiffness)

        batch = jax.vmap(solve)(jnp.array([1.0, 0.0, 2.0]))
        all_nan = jnp.isnan(batch.displacements[1]).all() & jnp.isnan(batch.energy[1])
        displacements = batch.displacement("block")[:, 1]
        return jnp.sum(jnp.where(batch.succeeded, displacements, 0.0)), all_nan

    (value, all_nan), gradient = jax.value_and_grad(total, has_aux=True)(jnp.array(4.0))
    assert all_nan
    assert_close(value, 2 / 4 + 2 / 8)
    assert_close(gradient, -2 / 16 - 2 / 32)


def test_batch_has_the_same_solutions_as_single_solves():
    """The batch has designs that need few and many load increments."""
    mechanism = cantilever(6)

    def tip(force):
        load = tj.Load("6", force=(0.0, force))
        return tj.equilibrium(mechanism, loads=[load], throw=False).displacement("6")

    forces = np.array([1e-3, 1.0, 20.0])
    single = np.array([tip(force) for force in forces])
    assert_close(jax.jit(jax.vmap(tip))(forces), single, digits=10)


def test_failed_designs_do_not_affect_the_rest_of_a_batch():
    stiffnesses = np.array([4.0, 0.0, np.nan, 4.0])
    forces = np.array([2.0, 2.0, 2.0, np.nan])
    batch = jax.jit(jax.vmap(solve_block))(stiffnesses, forces)
    names = tj.result_names(batch.result)
    assert names is not None
    assert list(names) == ["successful", "unstable", "not_finite", "not_finite"]
    assert_close(np.asarray(batch.displacements)[0, 1], [0.0, 0.5, 0.0])


@pytest.mark.slow
def test_the_derivative_by_a_load_does_not_differentiate_the_hinges():
    """Its program has fewer operations than the derivative by load and stiffness."""
    stiffness = jnp.asarray(some_stiffness(0))

    def operations(function):
        return len(jax.jit(function).lower(1.0).as_text().splitlines())

    def solve(force, stiffness):
        load = tj.Load("block", force=(force, 0.0))
        solution = tj.equilibrium(block_on_spring(stiffness), loads=[load], throw=False)
        return solution.displacements, solution.reactions, solution.energy

    value = operations(lambda force: solve(force, stiffness))
    by_load = operations(jax.jacfwd(lambda force: solve(force, stiffness)))
    by_both = operations(jax.jacfwd(lambda force: solve(force, force * stiffness)))
    assert by_load - value < 0.9 * (by_both - value)
