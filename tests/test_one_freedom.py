"""Energies of flexures with one compliant direction, against their definition."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import with_value
from numpy.testing import assert_allclose as assert_close
from scipy.optimize import minimize

import twistorjax as tj
from twistorjax.geometry import se2
from twistorjax.geometry.twistors import Displacement


POWERS = [
    (i, j, k)
    for i in range(4)
    for j in range(4)
    for k in range(4)
    if 1 < i + j + k < 6 and j + k <= 4
]


class TestOneFreedomEnergy:
    @staticmethod
    def energy(freedom):
        values = 0.02 * np.random.default_rng(3).normal(size=len(POWERS))
        for row, value in {(2, 0, 0): 1.0, (0, 2, 0): -0.5, (0, 0, 2): -0.4}.items():
            values[POWERS.index(row)] = value
        return tj.energies.OneFreedomEnergy(
            values, POWERS, freedom=freedom, length=0.5, force=2.0
        )

    @pytest.mark.parametrize("freedom", ["rotation", "transverse"])
    def test_it_is_the_maximum_over_both_forces(self, freedom):
        energy = self.energy(freedom)
        twist = np.array([0.2, 0.1, -0.07])
        compliant = twist[0] if freedom == "rotation" else twist[2] / 0.5
        stretch = twist[1:] * 2.0 if freedom == "rotation" else twist[:2] * [1.0, 2.0]

        def negative(forces):
            terms = [compliant**i * forces[0] ** j * forces[1] ** k for i, j, k in POWERS]
            return -(forces @ stretch + np.dot(energy.coefficients, terms))

        found = minimize(negative, np.zeros(2), tol=1e-13, method="Nelder-Mead")
        assert np.all(np.abs(found.x) < 1)  # no saturation
        value = jax.jit(lambda twist: energy(se2.exp(twist)))(twist)
        assert_close(value, -found.fun, rtol=1e-10)

    @pytest.fixture(scope="class")
    @classmethod
    def derivatives(cls):
        """Compute Hessian and gradient of the energy by the twist."""
        energy = cls.energy("rotation")
        gradient = jax.grad(lambda twist: energy(se2.exp(twist)))
        return jax.jit(jax.jacfwd(with_value(gradient), has_aux=True))

    @pytest.mark.parametrize("factor", [1.0, 10.0])
    def test_it_is_smooth_inside_and_outside_of_the_reference_forces(
        self, factor, derivatives
    ):
        twist = factor * np.array([0.1, 0.3, -0.2])
        hessian, _ = derivatives(twist)
        after, before = (
            np.array([derivatives(twist + side * row)[1] for row in np.eye(3)])
            for side in (1e-6, -1e-6)
        )
        assert_close(hessian, (after - before) / 2e-6, rtol=1e-6, atol=1e-7)

    def test_its_damping_is_proportional_to_the_stiffness_at_any_displacement(
        self, derivatives
    ):
        """A stretch is damped with one time, also where the hinge is softer."""
        energy, time = self.energy("rotation"), 0.1
        twist, rates = np.array([0.6, -0.05, 0.02]), np.array([0.0, 0.02, -0.01])

        @jax.jit
        def damping(twist, rates, time):
            at = Displacement.from_pose(se2.exp(twist))
            resisted = energy.resisted_rates(at, tuple(rates))
            matrix = energy.proportional_damping(time).damping
            return jnp.stack(resisted), matrix

        resisted, matrix = map(np.asarray, damping(twist, rates, time))
        power = resisted @ matrix @ resisted
        stiffness = np.asarray(derivatives(twist)[0])
        assert_close(power, time * rates @ stiffness @ rates, rtol=1e-9)
