"""Small designs and experiments on which identification is tested."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

import twistorjax as tj
from twistorjax.identification import (
    AbstractTest,
    BodySensor,
    MotionTest,
    Parameter,
    StaticTest,
)


TRUE = {"rotation": 1.0, "along": 100.0, "across": 400.0}


def spring(k):
    """Block on a spring with the stiffnesses of rotation, along x and along y.

    Stiffnesses that are not given have their values in `TRUE`.
    """
    diagonal = [
        jnp.asarray(k.get(name, TRUE[name]), float)
        for name in ("rotation", "along", "across")
    ]
    energy = tj.Quadratic(jnp.diag(jnp.stack(diagonal)))
    hinge = tj.Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
    block = tj.Body("block", mass=2.0, inertia=0.1)
    return tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])


def positive(value, unit=""):
    return Parameter(value, unit, lower=0)


def push(force, standard_deviation=1e-4):
    """Test that pushes the block along x and measures its displacement along x."""
    sensor = BodySensor("block", "x", standard_deviation)
    return StaticTest([[tj.Load("block", force=(force, 0.0))]], [sensor])


def push_series(forces, standard_deviation):
    """Test with one load case for each force along x."""
    sensor = BodySensor("block", "x", standard_deviation)
    load_cases = [[tj.Load("block", force=(force, 0.0))] for force in forces]
    return StaticTest(load_cases, [sensor])


def free_vibration(times, sensors, *, velocity, tolerance):
    """Test that releases the block with a velocity (angular, along x, along y)."""
    return MotionTest(times, sensors, velocities={"block": velocity}, tolerance=tolerance)


class FormulaTest(AbstractTest):
    """Test whose readings are a function of the two coordinates of a body."""

    function: Callable = eqx.field(static=True)
    deviations: jax.Array

    @property
    def columns(self):
        return ("value",)

    @property
    def units(self):
        return ("",)

    @property
    def standard_deviations(self):
        return self.deviations[:, None]

    def predict(self, mechanism, *, forward=True, throw=True):
        return self.function(mechanism.reference[1, 1:])[:, None]


def body_at(parameters):
    """Mechanism with a body whose coordinates are the parameters a and b."""
    body = tj.Body("block", pose=(0.0, parameters["a"], parameters["b"]))
    energy = tj.Quadratic(jnp.eye(3))
    hinge = tj.Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
    return tj.Mechanism([tj.Body("wall"), body], [hinge], fixed=["wall"])


def minimize_formula(function, deviations, start, **settings):
    """Minimize the residuals of a formula, divided by their standard deviations."""
    deviations = jnp.asarray(deviations, float)
    parameters = {name: Parameter(value) for name, value in start.items()}
    zeros = jnp.zeros((len(deviations), 1))
    data = FormulaTest(function, deviations).measurement(zeros)
    return tj.identify(body_at, parameters, [data], **settings)
