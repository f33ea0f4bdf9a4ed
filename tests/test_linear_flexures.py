"""Warnings of displacements for which linear flexures are not accurate."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mostly_slow
from scipy.integrate import solve_bvp

import twistorjax as tj
from twistorjax.energies.base import range_share
from twistorjax.geometry.twistors import Displacement


UNIT = tj.Material(modulus=1.0, poisson=0.3)
LEAF = tj.flexures.linear_leaf(UNIT, length=1.0, thickness=0.01, width=12e6)


@functools.cache
def elastica(moment, force):
    """Return a leaf of unit length and bending stiffness, which does not stretch.

    `moment` and `force` along y act on its end. The result is (angle, translation in the
    mid-frame) of the two frames in its middle, and the wrench about frame b.
    """
    s = np.linspace(0, 1, 101)
    start = np.stack([moment * s, moment + 0 * s, s, 0 * s])
    solution = solve_bvp(
        lambda _, y: [y[1], -force * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])],
        lambda a, b: [a[0], b[1] - moment, a[2], a[3]],
        s, start, tol=1e-8, max_nodes=10_000,
    )  # fmt: skip
    assert solution.success
    angle, _, x, y = solution.y[:, -1]
    x, y = x - np.cos(angle) / 2 - 0.5, y - np.sin(angle) / 2
    cos, sin = np.cos(angle / 2), np.sin(angle / 2)
    across = cos * y - sin * x
    transverse = np.cos(angle) * force
    return angle, across, np.array([moment + transverse / 2, transverse])


def pose_of(angle, across):
    """Return the pose of frame b without a mid-frame translation along axis 1."""
    return jnp.array([angle, -np.sin(angle / 2) * across, np.cos(angle / 2) * across])


@pytest.mark.parametrize("coordinates", ["twistor", "twist"])
def test_within_its_range_a_linear_leaf_errs_by_at_most_five_percent(coordinates):
    """Force and moment against the elastica, in twelve directions of the plane."""
    energy = tj.Quadratic(LEAF.stiffness, coordinates, flexure=True)
    wrench = jax.jit(lambda pose: energy.wrench(pose))
    units, inside, outside = np.array([1.0, np.sqrt(1 / 12)]), [], []
    for direction in np.radians(np.arange(0, 180, 15)):
        for size in (0.8, 0.9, 1.0, 1.1, 1.6):
            rotation = 0.35 * size * np.cos(direction)
            force = 12 * 0.15 * size * np.sin(direction)
            angle, across, exact = elastica(rotation - force / 2, force)
            pose = pose_of(angle, across)
            linear = np.asarray(wrench(pose))[[0, 2]]
            error = np.linalg.norm(units * (linear - exact))
            share = _share(energy, Displacement.from_pose(pose))
            found = inside if share <= 1 else outside
            found.append(error / np.linalg.norm(units * exact))
    assert 0.03 < max(inside) < 0.05
    assert max(outside) > 0.1


def _share(energy, displacement):
    share = range_share(energy, displacement)
    assert share is not None
    return float(share)


def cantilever(energy):
    hinge = tj.Hinge("leaf", "wall", "tip", energy, at=(0, 0, 0))
    return tj.Mechanism([tj.Body("wall"), tj.Body("tip")], [hinge], fixed=["wall"])


def test_large_displacements_of_linear_leaves_are_reported():
    steel = tj.Material(210e9, poisson=0.3)
    leaf = tj.flexures.linear_leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
    mechanism = cantilever(leaf)
    drive = [tj.Drive("tip", y=1.19)]
    text = "of the hinge 'leaf' is .* times"
    with pytest.warns(UserWarning, match=text) as found:
        tj.equilibrium(mechanism, drives=drive)
    assert found[0].filename == __file__
    tj.equilibrium(mechanism, drives=[tj.Drive("tip", y=1e-3)])  # a warning is an error
    spring = tj.Quadratic(leaf.stiffness)
    tj.equilibrium(cantilever(spring), drives=drive)


@pytest.mark.slow
def test_a_batch_reports_its_shares():
    """Nothing is printed inside a compiled program."""

    def share(travel):
        solution = tj.equilibrium(cantilever(LEAF), drives=[tj.Drive("tip", y=travel)])
        assert solution.range_shares is not None
        return solution.range_shares[0]

    shares = jax.jit(jax.vmap(share))(jnp.array([0.0, 0.01, 0.3]))
    assert float(shares[0]) == 0.0
    assert bool(shares[1] < 1) and bool(shares[2] > 1)
    assert bool(jnp.isfinite(jax.grad(share)(0.0)))


def test_sums_and_files_keep_the_range(tmp_path):
    both = LEAF + 2 * tj.Quadratic(np.eye(3))
    at = Displacement.from_pose(jnp.array([0.7, 0.0, 0.0]))
    np.testing.assert_allclose(_share(both, at), 2.0)
    tj.io.save_energy(LEAF, tmp_path / "leaf.json")
    loaded = tj.io.load_energy(tmp_path / "leaf.json")
    np.testing.assert_allclose(_share(loaded, at), 2.0)


def guide(energy):
    """A table on two leaves along y, which bear its axial load."""
    hinges = [
        tj.Hinge(name, "base", "table", energy, at=(np.pi / 2, x, 0.5))
        for name, x in (("left", -1.0), ("right", 1.0))
    ]
    table = tj.Body("table", pose=(0.0, 0.0, 1.0), mass=1.0, inertia=1.0)
    return tj.Mechanism([tj.Body("base"), table], hinges, fixed=["base"])


def guided_stiffness(p):
    """Transverse stiffness of a beam-column with parallel ends; EI/L^3."""
    k = np.sqrt(complex(p))
    return (p / (1 - 2 / k * np.tanh(k / 2))).real


ENERGIES = {
    "linear_leaf": (LEAF, (-0.5, 0.5)),
    "quartic_leaf": (
        tj.flexures.quartic_leaf(UNIT, length=1.0, thickness=0.01, width=12e6),
        (-8.17, 84.3),
    ),
}


@pytest.mark.parametrize("name", ENERGIES)
def test_the_transverse_stiffness_errs_by_five_percent_at_the_limit_of_the_force(name):
    energy, limits = ENERGIES[name]
    for p in limits:
        pose = jnp.array([0.0, p / 120_000, 0.0])
        tangent = jax.jit(lambda pose: energy.tangent_stiffness(pose))(pose)
        stiffness = np.asarray(tangent)[2, 2]
        np.testing.assert_allclose(
            abs(stiffness / guided_stiffness(p) - 1), 0.05, atol=3e-3
        )
        share = _share(energy, Displacement.from_pose(pose))
        np.testing.assert_allclose(share, 1.0, rtol=1e-6)


PUSH = tj.Load("table", force=(1.0, 0.0))
ANALYSES = {
    "vibrations": tj.vibrations,
    "linearize": tj.linearize,
    "frequency_response": lambda mechanism, about, loads: tj.frequency_response(
        mechanism, [1.0], about=about, static_loads=loads, loads=[PUSH]
    ),
    "state_space": lambda mechanism, about, loads: tj.state_space(
        mechanism, {"push": PUSH}, {"x": ("table", "x")}, about=about, loads=loads
    ),
}


@pytest.mark.parametrize("name", mostly_slow(ENERGIES))
@pytest.mark.parametrize("analysis", mostly_slow(ANALYSES))
def test_every_analysis_about_a_state_warns_of_its_axial_force(analysis, name):
    energy, (_, limit) = ENERGIES[name]
    mechanism, analyze = guide(energy), ANALYSES[analysis]
    mild, strong = (
        [tj.Load("table", force=(0.0, 2 * share * limit))] for share in (0.9, 1.1)
    )
    about = tj.equilibrium(mechanism, loads=mild)  # a warning is an error
    text = r"axial force of the hinge '(left|right)' is 1.1 times"
    with pytest.warns(UserWarning, match=text):
        beyond = tj.equilibrium(mechanism, loads=strong)
    analyze(mechanism, about=about, loads=mild)
    with pytest.warns(UserWarning, match=text):
        analyze(mechanism, about=beyond, loads=strong)
