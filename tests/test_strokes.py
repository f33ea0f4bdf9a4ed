"""Strokes that change with time, and harmonic strokes."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close, some_stiffness
from scipy.integrate import solve_ivp

import twistorjax as tj
from twistorjax.mechanism.changes import HingeChanges


STIFFNESS, DAMPING, MASS = 400.0, 0.3, 2.0  # N/m, N s/m, kg


def actuated_block():
    """Return a block between an actuator and a spring, which only move along x."""
    actuator = tj.Quadratic(np.diag([1.0, STIFFNESS, 1.0]))
    spring = tj.Quadratic(np.diag([1.0, 100.0, 1.0]))
    hinges = [
        tj.Hinge(
            "actuator", "wall", "block", actuator, (0, 0, 0),
            damping=tj.energies.ViscousDamping(np.diag([0.0, DAMPING, 0.0])),
        ),
        tj.Hinge("spring", "block", "wall", spring, (0, 0, 0)),
    ]  # fmt: skip
    bodies = [tj.Body("wall"), tj.Body("block", mass=MASS, inertia=0.1)]
    return tj.Mechanism(bodies, hinges, fixed=["wall"])


def stroke(time):
    return 1e-2 * jnp.sin(20 * time) * time


@pytest.mark.release
def test_a_block_follows_an_actuator_as_a_base_excited_oscillator():
    """The actuator is a spring and a damper whose other ends move by the stroke."""
    times = np.linspace(0.0, 1.0, 6)
    motion = tj.simulate(
        actuated_block(),
        times,
        strokes=lambda time: {"actuator": (0.0, stroke(time), 0.0)},
        tolerance=1e-10,
    )

    def slope(time, state):
        x, speed = state
        base, base_speed = jax.jvp(stroke, (time,), (1.0,))
        force = STIFFNESS * (base - x) + DAMPING * (base_speed - speed) - 100.0 * x
        return [speed, float(force) / MASS]

    exact = solve_ivp(slope, (0, 1), [0, 0], t_eval=times, rtol=1e-10, atol=1e-13)
    assert np.max(np.abs(exact.y[0])) > 5e-3
    np.testing.assert_allclose(motion.displacement("block")[:, 1], exact.y[0], atol=1e-9)
    by_strokes = np.max(np.abs(motion.energies.by_strokes))
    assert by_strokes > 1e-2
    assert np.max(np.abs(motion.energies.imbalance)) < 1e-8 * by_strokes


def whirling_mechanism(misfit=None, damping_time=1e-2):
    """Return two bodies on damped hinges that are displaced in all directions."""
    energy = tj.Quadratic(some_stiffness(3))
    damping = tj.energies.ViscousDamping(damping_time * some_stiffness(3))
    bodies = [
        tj.Body("ground"),
        tj.Body("first", (0.1, 0.2, 0.0), mass=1.0, inertia=0.02),
        tj.Body("second", (-0.2, 0.5, 0.3), mass=2.0, inertia=0.05),
    ]
    hinges = [
        tj.Hinge("a", "ground", "first", energy, (0.3, 0.1, 0.0), damping=damping),
        tj.Hinge(
            "b",
            "second",
            "first",
            energy,
            (1.0, 0.4, 0.1),
            damping=damping,
            misfit=misfit,
        ),
    ]
    return tj.Mechanism(bodies, hinges, fixed=["ground"])


class Strokes(eqx.Module):
    """Strokes of the hinges a and b: rates times time, and harmonic ones.

    Strokes with other numbers do not compile another program, but other functions do.
    """

    rates: Any
    amplitudes: Any
    frequency: Any = 0.0

    def __call__(self, time):
        wave = jnp.cos(self.frequency * time)
        return dict(zip("ab", self.rates * time + wave * self.amplitudes, strict=True))


WHIRLING = Strokes(
    rates=jnp.array([[0.0, 0.05, 0.02], [0.3, 0.0, -0.04]]),
    amplitudes=jnp.array([[0.2, 0.0, 0.01], [0.0, 0.02, 0.0]]),
    frequency=jnp.array(4.0),
)
MISFIT = (0.2, 0.03, -0.05)


def whirl(mechanism, times, strokes, *, velocities=None, **settings):
    """Simulate the whirling mechanism, with the velocities of its two bodies."""
    velocities = np.zeros((2, 3)) if velocities is None else velocities
    given = {"first": velocities[0], "second": velocities[1]}
    return tj.simulate(mechanism, times, strokes=strokes, velocities=given, **settings)


WHIRL = np.linspace(0.0, 1.0, 5)


@pytest.fixture(scope="module")
def whirling():
    """A mechanism with misfits, and its motion under strokes."""
    mechanism = whirling_mechanism(MISFIT)
    return mechanism, whirl(mechanism, WHIRL, WHIRLING, tolerance=1e-9)


def check_energy_balance(motion):
    """The balance contains the work of the strokes and of the damping."""
    energies = motion.energies
    assert np.asarray(energies.dissipated)[-1] > 1e-3
    largest = 1e-6 * np.asarray(energies.elastic)[-1]
    assert np.all(np.abs(np.asarray(energies.imbalance)) < largest)


def test_energy_is_balanced_while_hinges_are_displaced_and_turned(whirling):
    _, motion = whirling
    check_energy_balance(motion)


@pytest.mark.slow
def test_energy_is_balanced_in_a_mechanism_without_misfits():
    check_energy_balance(whirl(whirling_mechanism(), WHIRL, WHIRLING, tolerance=1e-9))


@pytest.mark.slow
def test_constant_strokes_are_misfits_in_a_motion():
    mechanism, strokes, times = whirling_mechanism(), WHIRLING(0.7), [0.0, 0.2]
    rates = jnp.zeros((2, 3))
    constant = Strokes(rates, jnp.stack([*strokes.values()]), jnp.array(0.0))
    none = Strokes(rates, jnp.zeros((2, 3)), jnp.array(0.0))
    by_function = whirl(mechanism, times, constant)
    for other in (
        whirl(mechanism, times, strokes),
        whirl(mechanism.with_strokes(strokes), times, none),
    ):
        assert_close(other.displacements, by_function.displacements, digits=12)


@pytest.mark.release
def test_a_motion_has_derivatives_by_its_strokes():
    mechanism = whirling_mechanism()

    def angle(amplitude):
        motion = tj.simulate(
            mechanism,
            [0.0, 0.5],
            strokes=lambda time: {"a": (amplitude * time, 0.0, 0.0)},
            tolerance=1e-10,
            energies=False,
        )
        return motion.displacement("second")[-1, 0]

    difference = (angle(0.301) - angle(0.299)) / 0.002
    assert_close(jax.jit(jax.grad(angle))(0.3) / difference, jnp.ones(()), digits=5)


def test_the_response_to_a_harmonic_stroke_is_that_of_the_motion():
    mechanism, frequency = actuated_block(), 1.5
    response = tj.frequency_response(
        mechanism, [0.0, frequency], strokes={"actuator": (0.0, 1e-3, 0.0)}
    )
    omega = 2 * np.pi * np.array([0.0, frequency])
    base = STIFFNESS + 1j * omega * DAMPING
    expected = 1e-3 * base / (base + 100.0 - MASS * omega**2)
    found = np.asarray(response.displacement("block"))[:, 1]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.slow
def test_a_harmonic_stroke_about_a_preloaded_equilibrium():
    """A motion that starts in the harmonic response stays in it."""
    mechanism = whirling_mechanism(MISFIT, damping_time=0.3)
    about, frequency, amplitude = tj.equilibrium(mechanism), 2.0, 1e-6
    shape = jnp.array([1.0, 0.2, -0.1])
    response = tj.frequency_response(
        mechanism, [frequency], about=about, strokes={"a": shape}
    )
    expected, omega = amplitude * response.displacements[0], 2 * np.pi * frequency
    times = np.linspace(0.0, 0.5, 9)
    motion = whirl(
        mechanism,
        times,
        Strokes(
            rates=jnp.zeros((2, 3)),
            amplitudes=amplitude * jnp.stack([shape, jnp.zeros(3)]),
            frequency=jnp.array(omega),
        ),
        start=about.displacements + mechanism.reference + jnp.real(expected),
        velocities=-omega * jnp.imag(expected[1:]),
        tolerance=1e-13,
    )
    change = np.asarray(motion.displacements) - np.asarray(about.displacements)
    harmonic = np.exp(1j * omega * times)[:, None, None] * np.asarray(expected)
    size = np.max(np.abs(harmonic), axis=(0, 1))
    np.testing.assert_allclose(change / size, np.real(harmonic) / size, atol=1e-5)


def test_other_numbers_of_constant_strokes_are_arguments_of_the_same_program():
    given = HingeChanges.of({"a": (0.0, 1e-6, 0)}, None)
    assert len(list(filter(eqx.is_array, jax.tree.leaves(given)))) == 3


def test_unknown_actuators_are_named():
    with pytest.raises(ValueError, match="piezo"):
        tj.simulate(
            actuated_block(), [0, 1], strokes=lambda time: {"piezo": (0, time, 0)}
        )
    with pytest.raises(ValueError, match="piezo"):
        tj.frequency_response(actuated_block(), [1.0], strokes={"piezo": (0, 1, 0)})


def test_hinges_are_queried_with_the_strokes_of_a_solution(whirling):
    """Energies and wrenches of a motion, and of a linear response, include strokes."""
    mechanism, motion = whirling

    @jax.jit
    def queries(motion):
        energies = [mechanism.energy_of(name, motion) for name in "ab"]
        return energies, mechanism.wrench_of("b", motion)

    @jax.jit
    @jax.vmap
    def expected_wrench(time, poses):
        return mechanism.with_strokes(WHIRLING(time)).wrench_of("b", poses)

    energies, wrenches = queries(motion)
    assert_close(np.sum(np.array(energies), axis=0), motion.energies.elastic, digits=12)
    columns = motion.columns()
    assert_close(columns["energy_by_strokes"].values, motion.energies.by_strokes)
    assert_close(wrenches, expected_wrench(WHIRL, motion.poses), digits=9)


def test_hinges_are_queried_with_the_strokes_of_a_linear_response():
    plain = actuated_block()
    response = tj.linearize(plain)(strokes={"actuator": (0.0, 1e-4, 0.0)})
    names = "actuator", "spring"
    query = jax.jit(lambda found: [plain.wrench_of(name, found) for name in names])
    wrenches = np.array(query(response))[:, 1]
    # Both hinges are compressed by the same force, that of two springs in series.
    force = -1e-4 / (1 / STIFFNESS + 1 / 100.0)
    np.testing.assert_allclose(wrenches, force, rtol=1e-9)


@pytest.mark.untyped
def test_strokes_that_are_no_mapping_are_refused():
    strokes: Any = (0, 1e-6, 0)
    with pytest.raises(ValueError, match="must be a mapping from names of hinges"):
        tj.simulate(actuated_block(), [0, 1], strokes=strokes)


def test_an_equilibrium_of_other_strokes_is_refused():
    """The mechanism without the stroke would have another wrench."""
    block = actuated_block()
    driven = block.with_strokes({"actuator": (0.0, 1e-2, 0.0)})
    found = tj.equilibrium(driven)
    x = 1e-2 * STIFFNESS / (STIFFNESS + 100)
    wrench = driven.wrench_of("actuator", found)
    assert_close(wrench[1], STIFFNESS * (x - 1e-2))
    for other in (block, block.with_strokes({"actuator": (0.0, 2e-2, 0.0)})):
        with pytest.raises(ValueError, match="a mechanism with other misfits, strokes"):
            other.wrench_of("actuator", found)
