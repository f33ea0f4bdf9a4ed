"""Energies that are sums: damped, solved and saved as their terms side by side."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close

import twistorjax as tj


pytestmark = pytest.mark.slow

STEEL = tj.Material(modulus=210e9, poisson=0.3)
ZERO = tj.Quadratic(jnp.zeros((3, 3)))


def leaf(thickness=0.5e-3):
    return tj.flexures.quartic_leaf(STEEL, length=50e-3, thickness=thickness, width=10e-3)


def table(energy, damping=None):
    """A table on two upright hinges, which sinks as it is pushed."""
    names = {"left": -40e-3, "right": 40e-3}
    hinges = [
        tj.Hinge(
            name, "base", "table", energy, (np.pi / 2, x, 0.0), damping=damping
        )
        for name, x in names.items()
    ]  # fmt: skip
    top = tj.Body("table", (0.0, 0.0, 30e-3), mass=0.1, inertia=1e-4)
    return tj.Mechanism([tj.Body("base"), top], hinges, fixed=["base"])


def pushed(energy, force=5.0):
    return tj.equilibrium(table(energy), loads=[tj.Load("table", (0.0, force, 0.0))])


SUMS = {
    "leaf and nothing": lambda leaf: leaf + ZERO,
    "nothing and leaf": lambda leaf: ZERO + leaf,
    "three shares": lambda leaf: 0.2 * leaf + (0.3 * leaf + 0.5 * leaf),
    "a multiple of a sum": lambda leaf: 2.0 * (0.25 * leaf + 0.25 * leaf),
    "a range of a sum": lambda leaf: tj.energies.WithValidityRange(
        0.5 * leaf + 0.5 * leaf, rotation=1.0, force=1e6, error=[0.0, 0.0, 0.0]
    ),
}
every_sum = pytest.mark.parametrize("add", SUMS.values(), ids=SUMS.keys())


@every_sum
def test_a_sum_takes_the_newton_steps_of_its_terms(add):
    """A cantilever of a thousandth of its length, bent by 16 degrees."""
    thin, length = leaf(0.05e-3), 50e-3
    force = 0.5 * 210e9 * 10e-3 * 0.05e-3**3 / 12 / length**2

    def bent(energy):
        hinge = tj.Hinge("leaf", "wall", "tip", energy, (0.0, length / 2, 0.0))
        bodies = [tj.Body("wall"), tj.Body("tip", (0.0, length, 0.0))]
        beam = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        return tj.equilibrium(beam, loads=[tj.Load("tip", (0.0, 0.0, force))])

    alone, added = bent(thin), bent(add(thin))
    assert_close(added.displacements, alone.displacements, digits=9)
    assert added.steps <= alone.steps + 1


def released(energy, damping):
    """A table that is let go from where it is pushed."""
    start = pushed(leaf(), 20.0)
    return tj.simulate(table(energy, damping), [0.0, 0.02], start=start)


def test_a_sum_moves_and_is_damped_as_its_terms():
    alone = released(leaf(), 1e-4)
    added = released(SUMS["a range of a sum"](leaf()), 1e-4)
    np.testing.assert_allclose(added.displacements, alone.displacements, atol=1e-7)
    assert abs(int(added.steps) - int(alone.steps)) <= 0.1 * int(alone.steps)
    lost = added.energies.dissipated, alone.energies.dissipated
    np.testing.assert_allclose(*lost, rtol=1e-4, atol=1e-9)


def test_a_damping_as_such_acts_once_on_what_the_flexure_resists():
    """It is that of the time that it is made of."""
    damping = tj.energies.ViscousDamping(
        1e-4 * leaf().tangent_stiffness(), "twist", resisted=True
    )
    alone, added = released(leaf(), damping), released(ZERO + leaf(), damping)
    np.testing.assert_allclose(added.displacements, alone.displacements, atol=1e-7)


def test_the_range_of_a_sum_is_seen():
    narrow = tj.energies.WithValidityRange(
        leaf() + leaf(), rotation=1e-4, force=1e6, error=[0.0, 0.0, 0.0]
    )
    asked = [tj.Drive("table", angle=2e-4)]
    answer = tj.equilibrium(table(narrow), drives=asked, throw=False)
    assert str(tj.result_names(answer.result)) == "out_of_range"
    with pytest.raises(RuntimeError, match=r"'left': its rotation is 0\.0002 rad"):
        tj.equilibrium(table(narrow), drives=asked)


def test_a_mechanism_of_sums_is_saved_as_it_is(tmp_path):
    energy = tj.energies.WithValidityRange(
        2.0 * (leaf() + ZERO), rotation=1.0, force=1e6, error=[0.0, 0.0, 0.0]
    )
    made = table(energy, damping=1e-4)
    tj.io.save_mechanism(made, tmp_path / "table.json")
    loaded = tj.io.load_mechanism(tmp_path / "table.json")
    pose = jnp.array([0.01, 1e-6, 1e-4])
    for row in range(2):
        both = made.hinge_assembly.energy_of(row), loaded.hinge_assembly.energy_of(row)
        assert type(both[1]) is tj.energies.WithValidityRange
        assert_close(both[0](pose), both[1](pose))
    ours, theirs = (jax.tree.leaves(each.hinge_assembly) for each in (made, loaded))
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(mine, other)
