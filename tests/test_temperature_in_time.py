"""Temperatures that change during a motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from scipy.integrate import solve_ivp

import twistorjax as tj


STIFFNESS, DAMPING, MASS = 400.0, 0.3, 2.0  # N/m, N s/m, kg
EXPANSION, LENGTH = 20e-6, 0.1  # 1/K, m


def heated_block():
    """Return a block on a heated actuator and a spring, which only moves along x."""
    actuator = tj.Quadratic(np.diag([1.0, STIFFNESS, 1.0]))
    spring = tj.Quadratic(np.diag([1.0, 100.0, 1.0]))
    hinges = [
        tj.Hinge(
            "actuator", "wall", "block", actuator, (0, 0, 0),
            damping=tj.energies.ViscousDamping(np.diag([0.0, DAMPING, 0.0])),
            expansion=tj.Expansion(EXPANSION, length=LENGTH),
        ),
        tj.Hinge("spring", "block", "wall", spring, (0, 0, 0)),
    ]  # fmt: skip
    bodies = [tj.Body("wall"), tj.Body("block", mass=MASS, inertia=0.1)]
    return tj.Mechanism(bodies, hinges, fixed=["wall"])


def heating(time):
    """Return the change of the temperature of an actuator that is heated; K."""
    return 300.0 * (1 - jnp.exp(-time / 0.1))


def exact_position(times, amplitude=1.0):
    """Integrate a block on a spring and a damper whose far end moves by the growth."""

    def slope(time, state):
        x, speed = state
        strain = EXPANSION * amplitude * 300.0 * (1 - np.exp(-time / 0.1))
        strain_rate = EXPANSION * amplitude * 3000.0 * np.exp(-time / 0.1)
        elastic = STIFFNESS * (LENGTH * strain - x)
        viscous = DAMPING * (LENGTH * strain_rate - speed)
        return [speed, (elastic + viscous - 100.0 * x) / MASS]

    span = (times[0], times[-1])
    solution = solve_ivp(slope, span, [0, 0], t_eval=times, rtol=1e-11, atol=1e-15)
    return solution.y[0]


def test_a_heated_actuator_moves_a_block_as_its_base_would():
    times = np.linspace(0.0, 0.2, 3)
    motion = tj.simulate(
        heated_block(),
        times,
        temperature=lambda time: tj.Temperature(hinges={"actuator": heating(time)}),
        tolerance=1e-10,
        energies=False,
    )
    expected = exact_position(times)
    assert np.max(np.abs(expected)) > 5e-4
    found = np.asarray(motion.displacement("block"))[:, 1]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def table_on_leaves(expansion=1e-2):
    """Return a table on two leaves whose dimensions change by percents."""
    steel = tj.Material(210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=0.05, thickness=0.5e-3, width=0.01)
    quartic = tj.flexures.quartic_leaf(steel, length=0.05, thickness=0.5e-3, width=0.01)
    growth = tj.Expansion(expansion, length=0.05)
    hinges = [
        tj.Hinge(
            name, "base", "table", energy, (np.pi / 2, x, 0.025), damping=damping,
            expansion=growth,
        )
        for name, x, energy, damping in (
            ("left", -0.02, leaf, None), ("right", 0.02, quartic, 1e-5)
        )
    ]  # fmt: skip
    bodies = [
        tj.Body("base", (0.0, 0.01, -0.02), expansion=expansion),
        tj.Body("table", (0.0, 0.0, 0.05), expansion=expansion, mass=1.0, inertia=1e-4),
    ]
    return tj.Mechanism(bodies, hinges, fixed=["base"])


def uneven(time):
    return tj.Temperature(
        2 * time, hinges={"left": 3 * jnp.sin(3 * time)}, gradients={"right": 200 * time}
    )


@pytest.mark.slow
def test_energy_is_balanced_while_hinges_expand():
    """Expansion changes misfits, arms, and stiffness, and each of them does work."""
    motion = tj.simulate(
        table_on_leaves(), [0.0, 0.02, 0.05], temperature=uneven, tolerance=1e-9
    )
    work = np.max(np.abs(motion.energies.by_strokes))
    assert work > 1e-6
    assert np.max(np.abs(motion.energies.imbalance)) < 1e-4 * work


@pytest.mark.slow
def test_hinges_of_a_motion_have_its_temperatures():
    mechanism, times = table_on_leaves(), [0.0, 0.005]
    motion = tj.simulate(mechanism, times, temperature=uneven)
    total = sum(mechanism.energy_of(name, motion) for name in ("left", "right"))
    assert_close(total, motion.energies.elastic, digits=12)
    change, bodies, hinges, gradients = uneven(times[1])
    warm = mechanism.at_temperature(
        change, bodies=bodies, hinges=hinges, gradients=gradients
    )
    for name in ("left", "right"):
        expected = warm.wrench_of(name, motion.displacements[1] + warm.reference)
        assert_close(mechanism.wrench_of(name, motion)[1], expected, digits=6)


@pytest.mark.release
def test_a_constant_temperature_is_that_of_the_mechanism():
    mechanism, times = table_on_leaves(), [0.0, 0.002]
    found = tj.simulate(mechanism, times, temperature=lambda time: 5e-3 + 0 * time)
    expected = tj.simulate(mechanism.at_temperature(5e-3), times)
    assert_close(found.displacements, expected.displacements, digits=10)


@pytest.mark.release
def test_a_motion_has_derivatives_by_its_temperature():
    mechanism = heated_block()

    def position(amplitude):
        motion = tj.simulate(
            mechanism,
            [0.0, 0.3],
            temperature=lambda time: tj.Temperature(
                hinges={"actuator": amplitude * heating(time)}
            ),
            tolerance=1e-10,
            energies=False,
        )
        return motion.displacement("block")[-1, 1]

    value, derivative = jax.jit(jax.value_and_grad(position))(1.0)
    lower, middle, upper = (
        exact_position([0.0, 0.3], amplitude)[-1] for amplitude in (0.99, 1.0, 1.01)
    )
    assert_close(value / middle, 1.0, digits=6)
    assert_close(derivative / ((upper - lower) / 0.02), 1.0, digits=5)


def test_hinges_that_cannot_expand_are_named():
    with pytest.raises(ValueError, match="The hinge 'spring' has no `expansion`"):
        tj.simulate(
            heated_block(),
            [0.0, 1.0],
            temperature=lambda time: tj.Temperature(hinges={"spring": 5 * time}),
        )
    with pytest.raises(ValueError, match="names the hinge 'heater'"):
        tj.simulate(
            heated_block(),
            [0.0, 1.0],
            temperature=lambda time: tj.Temperature(hinges={"heater": 5 * time}),
        )
