"""Mechanisms of many bodies, whose stiffness is factored by blocks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import some_stiffness

import twistorjax as tj
from twistorjax.solve.dofs import DofPartition
from twistorjax.solve.block_factorization import block_layout
from twistorjax.solve.system import System


pytestmark = pytest.mark.slow

COUNT = 60


def chain(stiffness):
    """Links of equal length, joined end to end, of which the first is the ground."""
    size = 1 / COUNT
    hinge = tj.Quadratic(stiffness, "twist")
    bodies = [tj.Body(str(k), (0.0, k * size, 0.0)) for k in range(COUNT + 1)]
    hinges = [
        tj.Hinge(str(k), str(k), str(k + 1), hinge, (0.0, (k + 0.5) * size, 0.0))
        for k in range(COUNT)
    ]
    return tj.Mechanism(bodies, hinges, fixed=["0"])


SLENDER = np.diag([COUNT, 1e6 * COUNT, 12 * COUNT**3])


def lattice(wide, long, fixed):
    """Bodies on a grid, each joined to its neighbours by hinges of every coupling."""
    bodies = [tj.Body(f"{i} {j}", (0.0, i, j)) for i in range(long) for j in range(wide)]
    hinges = []
    for i in range(long):
        for j in range(wide):
            for other, at in (
                ((i + 1, j), (0, i + 0.5, j)),
                ((i, j + 1), (0, i, j + 0.5)),
            ):
                if other[0] < long and other[1] < wide:
                    ends = f"{i} {j}", "{} {}".format(*other)
                    energy = tj.Quadratic(some_stiffness(i + j))
                    hinges.append(tj.Hinge(f"{ends}", *ends, energy, at))
    return tj.Mechanism(bodies, hinges, fixed=fixed)


def test_a_moment_winds_a_chain_into_a_polygon():
    """Pure moments turn each hinge alone, by the same angle."""
    wound = tj.equilibrium(chain(SLENDER), loads=[tj.Load(str(COUNT), (3.0, 0.0, 0.0))])
    angles = 3.0 / COUNT * np.arange(COUNT + 1)
    links = np.stack([np.cos(angles), np.sin(angles)]) / COUNT
    ends = np.cumsum(links, axis=1)[:, :-1] - links[:, :1] / 2
    places = np.concatenate([np.zeros((2, 1)), ends + links[:, 1:] / 2], axis=1)
    np.testing.assert_allclose(wound.poses[:, 0], angles, atol=1e-9)
    np.testing.assert_allclose(wound.poses[:, 1:], places.T, atol=1e-9)


def test_blocks_are_found_where_a_mechanism_is_long():
    def layout(mechanism):
        free = tuple(set(range(mechanism.reference.size)) - set(mechanism.fixed))
        return block_layout(mechanism.hinge_assembly.ends, tuple(sorted(free)))

    assert layout(chain(SLENDER)) is not None
    assert layout(lattice(3, 40, ["0 0"])) is not None
    assert layout(lattice(3, 4, ["0 0"])) is None  # few coordinates
    assert layout(lattice(7, 7, ["0 0"])) is None  # few blocks
    assert layout(lattice(30, 2, ["0 0"])) is not None  # in whatever order it is given
    assert layout(lattice(14, 14, ["0 0"])).size < 60


@pytest.mark.parametrize("follower", [False, True])
def test_blocks_solve_what_a_dense_matrix_does(follower):
    """With a body that can only turn, one driven in part, and loads at an offset."""
    fixed = {"0 0": ("angle", "x", "y"), "7 1": ("x", "y")}
    mechanism = lattice(3, 24, fixed)
    given = mechanism.coordinates("driven", {"23 2": ["angle", "y"]})
    free = sorted(
        set(range(mechanism.reference.size)) - set(mechanism.fixed) - set(given)
    )
    loaded = mechanism.index("23 2"), mechanism.index("11 1")
    loads = [
        tj.Load(mechanism.names[body], (0.3, 0.5, -0.2), at=(0.4, 0.1), follower=follower)
        for body in loaded
    ]
    system = System.of(mechanism, DofPartition.of(mechanism, given), loads)
    moved = 0.01 * jax.random.normal(jax.random.key(0), mechanism.reference.shape)
    right = jax.random.normal(jax.random.key(1), (len(free),))
    move = jnp.array([0.7, -0.4])

    @jax.jit
    def by_blocks(moved):
        _, tangent, _ = system.tangent(moved)
        factors = tangent.factors(system.loads.conservative)
        return factors.solve(right), tangent.push(move), factors.resists()

    solved, pushed, resists = by_blocks(moved)
    _, matrix, _ = system.matrix(moved, (*free, *given))
    matrix = np.asarray(matrix)
    own, by_given = matrix[:, : len(free)], matrix[:, len(free) :]
    np.testing.assert_allclose(solved, np.linalg.solve(own, right), rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(pushed, by_given @ move, rtol=1e-12, atol=1e-12)
    assert bool(resists) == bool(np.linalg.slogdet(own)[0] > 0)


def test_an_unstable_chain_is_refused():
    """Beyond Euler's load of a column, clamped at one end."""
    euler = np.pi**2 / 4

    def press(load):
        column = chain(SLENDER)
        down = tj.Load(str(COUNT), (0.0, -load, 0.0))
        return tj.equilibrium(column, loads=[down], throw=False)

    pressed = jax.vmap(press)(jnp.array([0.95 * euler, 1.05 * euler]))
    assert pressed.succeeded.tolist() == [True, False]


def test_derivatives_of_many_bodies_are_those_of_differences():
    def tip(stiffer):
        bent = tj.equilibrium(
            chain(jnp.diag(jnp.diagonal(SLENDER) * jnp.array([stiffer, 1.0, 1.0]))),
            loads=[tj.Load(str(COUNT), (0.0, 0.0, 1.0))],
        )
        return bent.displacement(str(COUNT))[2]

    @jax.jit
    def all_of_it(stiffer):
        slope, curve = jax.jvp(jax.grad(tip), (stiffer,), (1.0,))
        return tip(stiffer), slope, curve

    here, step = 1.3, 1e-3
    below, middle, above = (all_of_it(here + k * step) for k in (-1, 0, 1))
    slope = (above[0] - below[0]) / (2 * step)
    curve = (above[0] - 2 * middle[0] + below[0]) / step**2
    assert abs(middle[1] / slope - 1) < 1e-5
    assert abs(middle[2] / curve - 1) < 1e-4
