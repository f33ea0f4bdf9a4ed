"""Coefficients of a polynomial energy from one noisy motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistorjax as tj
from twistorjax.identification import BodySensor, identify, MotionTest, Parameter


TRUE_VALUES: dict[tuple[int, ...], float] = {
    (0, 2, 0, 0): 1.0,
    (0, 4, 0, 0): 2.0,
    (1, 2, 1, 0): 0.1,
    (0, 0, 2, 0): 0.1,
    (0, 2, 2, 0): 0.2,
    (1, 0, 3, 0): -0.02,
    (0, 0, 4, 0): 0.05,
    (0, 0, 0, 2): 0.08,
    (0, 2, 0, 2): -0.1,
    (1, 0, 1, 2): 0.03,
    (0, 0, 2, 2): 0.06,
    (0, 0, 0, 4): 0.04,
}
POWERS = [
    power
    for power in tj.energies.monomials(4, symmetry="leaf", redundant=True)
    if any(power[1:])
]


def energy_of(coefficients):
    return tj.energies.Polynomial(coefficients, POWERS, scale=10e-3)


def block_on_a_bush(coefficients):
    bush = tj.Hinge("bush", "frame", "block", energy_of(coefficients), at=(0, 0, 0))
    block = tj.Body("block", mass=0.3, inertia=1e-4)
    return tj.Mechanism([tj.Body("frame"), block], [bush], ["frame"])


@pytest.mark.slow
def test_a_motion_determines_all_coefficients_that_are_not_redundant():
    """The terms with sigma^2 are redundant, because sigma^2 = 1 - xi^2."""
    truth = jnp.array([TRUE_VALUES.get(power, 0.0) for power in POWERS])
    assert len(POWERS) == 17
    sensors = [
        BodySensor("block", "angle", 1e-4),
        BodySensor("block", "x", 2e-6),
        BodySensor("block", "y", 2e-6),
    ]
    released_at = [[0.0, 0.0, 0.0], [0.5, 4e-3, 3e-3]]
    test = MotionTest(np.linspace(0.0, 0.4, 201), sensors, start=released_at)
    motion = test.synthetic_data(block_on_a_bush(truth), 7)
    is_quadratic = np.array([p[0] == 0 and sum(p) == 2 for p in POWERS])
    start = Parameter(
        np.where(is_quadratic, 1.2 * np.asarray(truth), 0.0), "J", scale=np.full(17, 0.1)
    )
    result = identify(block_on_a_bush, start, [motion])
    assert len(result.undetermined_directions) == 4
    errors = np.asarray(result.standard_errors)
    determined = np.isfinite(errors)
    names = [power for power, flag in zip(POWERS, determined, strict=True) if flag]
    assert names == [
        (1, 0, 3, 0),
        (0, 0, 4, 0),
        (1, 0, 1, 2),
        (0, 0, 2, 2),
        (0, 0, 0, 4),
    ]
    deviations = (np.asarray(result.estimates) - np.asarray(truth))[determined]
    assert np.all(np.abs(deviations) < 3 * errors[determined])
    # The energy is determined, although the redundant coefficients are not.
    random = np.random.default_rng(0)
    displacements = jnp.asarray(random.uniform(-1, 1, (50, 3)) * [0.4, 3e-3, 3e-3])
    found = jax.vmap(energy_of(jnp.asarray(result.estimates)))(displacements)
    np.testing.assert_allclose(
        found, jax.vmap(energy_of(truth))(displacements), rtol=2e-3, atol=1e-5
    )
