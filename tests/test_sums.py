"""Sums of energies, which are solved, damped, and saved as parallel hinges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj
from twistorjax.energies.base import Sum


STEEL = tj.Material(modulus=210e9, poisson=0.3)
ZERO = tj.Quadratic(np.zeros((3, 3)))


def leaf(thickness=0.5e-3):
    return tj.flexures.quartic_leaf(STEEL, length=50e-3, thickness=thickness, width=10e-3)


def table(energy, damping=None):
    """Return a table on two upright hinges, which can move sideways."""
    hinges = [
        tj.Hinge(name, "base", "table", energy, (np.pi / 2, x, 0.0), damping=damping)
        for name, x in (("left", -40e-3), ("right", 40e-3))
    ]
    body = tj.Body("table", (0.0, 0.0, 30e-3), mass=0.1, inertia=1e-4)
    return tj.Mechanism([tj.Body("base"), body], hinges, fixed=["base"])


SUMS = {
    "sum with a validity range": lambda leaf: tj.energies.WithValidityRange(
        0.5 * leaf + 0.5 * leaf, rotation=1.0, force=1e6, error=[0.0, 0.0, 0.0]
    ),
    "leaf and zero": lambda leaf: leaf + ZERO,
    "zero and leaf": lambda leaf: ZERO + leaf,
    "three parts": lambda leaf: 0.2 * leaf + (0.3 * leaf + 0.5 * leaf),
    "multiple of a sum": lambda leaf: 2.0 * (0.25 * leaf + 0.25 * leaf),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SUMS)
def test_sum_takes_as_many_newton_steps_as_its_terms(name):
    """The leaf is thin, thickness / length = 1e-3, and its end rotates by 16 degrees."""
    thin, length = leaf(0.05e-3), 50e-3
    force = 0.5 * 210e9 * 10e-3 * 0.05e-3**3 / 12 / length**2

    def bend(energy):
        hinge = tj.Hinge("leaf", "wall", "tip", energy, (0.0, length / 2, 0.0))
        bodies = [tj.Body("wall"), tj.Body("tip", (0.0, length, 0.0))]
        beam = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        return tj.equilibrium(beam, loads=[tj.Load("tip", force=(0.0, force))])

    single, added = bend(thin), bend(SUMS[name](thin))
    assert_close(added.displacements, single.displacements, digits=9)
    assert added.steps <= single.steps + 1


@pytest.mark.slow
def test_table_on_sums_is_one_on_single_leaves():
    load = tj.Load("table", force=(20.0, -5.0))
    single, added = (
        tj.equilibrium(table(energy), loads=[load])
        for energy in (leaf(), SUMS["three parts"](leaf()))
    )
    assert_close(added.displacements, single.displacements, digits=9)


def release(energy, damping):
    """Simulate a table that is released from an equilibrium under a force."""
    load = tj.Load("table", force=(20.0, 0.0))
    start = tj.equilibrium(table(leaf()), loads=[load])
    return tj.simulate(table(energy, damping), [0.0, 0.02], start=start)


@pytest.mark.release
def test_sum_moves_and_is_damped_as_its_terms():
    single = release(leaf(), 1e-4)
    added = release(SUMS["sum with a validity range"](leaf()), 1e-4)
    np.testing.assert_allclose(added.displacements, single.displacements, atol=1e-7)
    assert abs(int(added.steps) - int(single.steps)) <= 0.1 * int(single.steps)
    dissipated = added.energies.dissipated, single.energies.dissipated
    np.testing.assert_allclose(*dissipated, rtol=1e-4, atol=1e-9)


@pytest.mark.release
def test_viscous_damping_of_a_sum_acts_once():
    """It acts on the rates of the one term that has stiffness."""
    damping = tj.energies.ViscousDamping(
        1e-4 * leaf().tangent_stiffness(), "twist", resisted=True
    )
    single, added = release(leaf(), damping), release(ZERO + leaf(), damping)
    np.testing.assert_allclose(added.displacements, single.displacements, atol=1e-7)


@pytest.mark.release
def test_validity_range_of_a_sum_is_checked():
    narrow = tj.energies.WithValidityRange(
        leaf() + leaf(), rotation=1e-4, force=1e6, error=[0.0, 0.0, 0.0]
    )
    drives = [tj.Drive("table", angle=2e-4)]
    solution = tj.equilibrium(table(narrow), drives=drives, throw=False)
    assert str(tj.result_names(solution.result)) == "out_of_range"
    with pytest.raises(RuntimeError, match=r"'left': its rotation is 0\.0002 rad"):
        tj.equilibrium(table(narrow), drives=drives)


def test_a_sum_needs_a_term():
    with pytest.raises(ValueError, match="`parts` is empty, but a sum needs"):
        Sum(())


def test_mechanism_with_sums_is_saved_and_loaded_unchanged(tmp_path):
    energy = tj.energies.WithValidityRange(
        2.0 * (leaf() + ZERO), rotation=1.0, force=1e6, error=[0.0, 0.0, 0.0]
    )
    saved = table(energy, damping=1e-4)
    tj.io.save_mechanism(saved, tmp_path / "table.json")
    loaded = tj.io.load_mechanism(tmp_path / "table.json")
    pose = jnp.array([0.01, 1e-6, 1e-4])
    for row in range(2):
        before = saved.hinge_assembly.energy_of(row)
        after = loaded.hinge_assembly.energy_of(row)
        assert type(after) is tj.energies.WithValidityRange
        assert_close(before(pose), after(pose))
    before, after = (jax.tree.leaves(each.hinge_assembly) for each in (saved, loaded))
    for value, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(value, other)
