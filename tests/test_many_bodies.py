"""Mechanisms of many bodies, whose stiffness is factored in blocks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import some_stiffness

import twistorjax as tj
from twistorjax.linalg.block_factors import block_layout
from twistorjax.solve.equations.problem import Problem


COUNT = 60
SLENDER = np.diag([COUNT, 1e6 * COUNT, 12 * COUNT**3])


def chain(stiffness):
    """Return a row of equal links, the first of which is fixed."""
    size = 1 / COUNT
    energy = tj.Quadratic(stiffness, "twist")
    bodies = [tj.Body(str(k), (0.0, k * size, 0.0)) for k in range(COUNT + 1)]
    hinges = [
        tj.Hinge(str(k), str(k), str(k + 1), energy, (0.0, (k + 0.5) * size, 0.0))
        for k in range(COUNT)
    ]
    return tj.Mechanism(bodies, hinges, fixed=["0"])


def lattice(columns, rows, fixed):
    """Return bodies on a grid, with hinges of full stiffness between neighbors."""
    grid = [(i, j) for i in range(rows) for j in range(columns)]
    energies = [tj.Quadratic(some_stiffness(k)) for k in range(rows + columns)]
    bodies = [tj.Body(f"{i} {j}", (0.0, i, j)) for i, j in grid]
    hinges = []
    for i, j in grid:
        energy = energies[i + j]
        if i + 1 < rows:
            ends, at = (f"{i} {j}", f"{i + 1} {j}"), (0, i + 0.5, j)
            hinges.append(tj.Hinge(f"{ends}", *ends, energy, at))
        if j + 1 < columns:
            ends, at = (f"{i} {j}", f"{i} {j + 1}"), (0, i, j + 0.5)
            hinges.append(tj.Hinge(f"{ends}", *ends, energy, at))
    return tj.Mechanism(bodies, hinges, fixed=fixed)


def test_moment_bends_a_chain_to_a_polygon():
    """A pure moment rotates all hinges by the same angle."""
    load = tj.Load(str(COUNT), moment=3.0)
    solution = tj.equilibrium(chain(SLENDER), loads=[load])
    angles = 3.0 / COUNT * np.arange(COUNT + 1)
    links = np.stack([np.cos(angles), np.sin(angles)]) / COUNT
    ends = np.cumsum(links, axis=1)[:, :-1] - links[:, :1] / 2
    positions = np.concatenate([np.zeros((2, 1)), ends + links[:, 1:] / 2], axis=1)
    np.testing.assert_allclose(solution.poses[:, 0], angles, atol=1e-9)
    np.testing.assert_allclose(solution.poses[:, 1:], positions.T, atol=1e-9)


def test_blocks_are_used_for_long_mechanisms_only():
    def layout(mechanism):
        free = tuple(set(range(mechanism.reference.size)) - set(mechanism.fixed))
        return block_layout(mechanism.hinge_assembly.ends, tuple(sorted(free)))

    fixed = ["0 0"]
    assert layout(chain(SLENDER)) is not None
    assert layout(lattice(3, 40, fixed)) is not None
    assert layout(lattice(3, 4, fixed)) is None  # few degrees of freedom
    assert layout(lattice(7, 7, fixed)) is None  # few blocks
    assert layout(lattice(30, 2, fixed)) is not None  # the order of bodies is arbitrary
    blocks = layout(lattice(14, 14, fixed))
    assert blocks is not None and blocks.size < 60


@pytest.mark.parametrize("follower", [False, True])
def test_block_factorization_agrees_with_a_dense_one(follower):
    """One body can only rotate; one is partly prescribed; loads act off the origins."""
    fixed = {"0 0": ("angle", "x", "y"), "7 1": ("x", "y")}
    mechanism = lattice(3, 24, fixed)
    prescribed = mechanism.dofs_of("prescribed", {"23 2": ["angle", "y"]})
    loads = [
        tj.Load(body, (0.3, 0.5, -0.2), at=(0.4, 0.1), follower=follower)
        for body in ("23 2", "11 1")
    ]
    problem = Problem.of(mechanism, loads, held=prescribed)
    system, dofs = problem.system, problem.dofs
    shape = mechanism.reference.shape
    rng = np.random.default_rng(0)
    displacements, right = 0.01 * rng.normal(size=shape), rng.normal(size=len(dofs.free))
    move = np.array([0.7, -0.4])

    @jax.jit
    def in_blocks_and_whole(displacements, right, move):
        _, tangent, _ = system.tangent(displacements)
        factors = tangent.factors(system.loads.conservative)
        in_blocks = *factors.solve_and_check(right), tangent.prescribed_forces(move)
        return in_blocks, system.whole_stiffness(displacements)[0]

    in_blocks, matrix = in_blocks_and_whole(displacements, right, move)
    solution, stable, forces = in_blocks
    matrix = np.asarray(matrix)[list(dofs.free)]
    by_free, by_prescribed = matrix[:, list(dofs.free)], matrix[:, list(prescribed)]
    expected = np.linalg.solve(by_free, right)
    np.testing.assert_allclose(solution, expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(forces, by_prescribed @ move, rtol=1e-12, atol=1e-12)
    assert bool(stable) == bool(np.linalg.slogdet(by_free)[0] > 0)


def test_chain_above_the_load_of_euler_is_unstable():
    euler = np.pi**2 / 4

    def is_stable(force):
        load = tj.Load(str(COUNT), force=(-force, 0.0))
        return tj.equilibrium(chain(SLENDER), loads=[load], throw=False).succeeded

    assert is_stable(0.95 * euler) and not is_stable(1.05 * euler)


@pytest.mark.release
def test_derivatives_of_a_long_chain_agree_with_differences():
    def tip(factor):
        factors = jnp.array([factor, 1.0, 1.0])
        mechanism = chain(jnp.diag(jnp.diagonal(SLENDER) * factors))
        load = tj.Load(str(COUNT), force=(0.0, 1.0))
        return tj.equilibrium(mechanism, loads=[load]).displacement(str(COUNT))[2]

    @jax.jit
    def with_derivatives(factor):
        first, second = jax.jvp(jax.grad(tip), (factor,), (1.0,))
        return tip(factor), first, second

    factor, step = 1.3, 1e-3
    before, (value, first, second), after = (
        with_derivatives(factor + k * step) for k in (-1, 0, 1)
    )
    first_difference = (after[0] - before[0]) / (2 * step)
    second_difference = (after[0] - 2 * value + before[0]) / step**2
    assert abs(first / first_difference - 1) < 1e-5
    assert abs(second / second_difference - 1) < 1e-4
