"""Parameters of an identification: bounds, scales, trees, and coefficients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import assert_close
from identification_helpers import body_at, FormulaTest, positive

import twistorjax as tj
from twistorjax.designs.parameters import ParameterSet
from twistorjax.identification import (
    BodySensor,
    identify,
    MotionTest,
    Parameter,
    StaticTest,
)


def test_values_stay_within_their_bounds_and_start_at_the_initial_value():
    for lower, upper in ((0, None), (None, 3), (-1, 3), (None, None)):
        parameter = Parameter(2.0, lower=lower, upper=upper)
        points = np.array([-30.0, 0.0, 30.0])
        values, derivatives = jax.jit(jax.vmap(jax.value_and_grad(parameter.value_at)))(
            points
        )
        assert_close(np.asarray(values)[1], 2.0, digits=12)
        assert_close(np.asarray(derivatives)[1], parameter.initial_scale(), digits=9)
        assert np.all(values >= (-np.inf if lower is None else lower))
        assert np.all(values <= (np.inf if upper is None else upper))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((1.0,), {"lower": 4, "upper": 0}), "are the bounds exchanged"),
        (((-1.0,), {"lower": 0}), "is -1.0, but must not be below 0"),
        (((4.1,), {"lower": 0, "upper": 4}), "must not be below 0 or above 4"),
        (((jnp.nan,), {}), "must be finite"),
        (((1.0,), {"lower": np.nan}), "`lower` of a `Parameter` is nan"),
        (((0.0,), {}), "typical change is not known: give it as `scale`"),
        (((1.0,), {"lower": 0, "scale": 1.0}), "leave out `scale`"),
        (((np.ones(2), ("N",)), {}), "`unit` has 1 entries"),
    ],
)
def test_wrong_parameters_are_rejected(arguments, message):
    with pytest.raises(ValueError, match=message):
        Parameter(*arguments[0], **arguments[1])


def test_a_bound_is_a_start_of_an_optimization_and_not_of_an_identification():
    start = {"x": Parameter(4.0, lower=0, upper=4)}
    optimum = tj.optimize(lambda at: {"f": (at["x"] - 1.0) ** 2}, start, minimize="f")
    np.testing.assert_allclose(optimum.parameters["x"], 1.0, atol=1e-5)
    with pytest.raises(ValueError, match="'x' begins at a bound"):
        ParameterSet.from_tree(start)


@pytest.mark.slow
def test_the_parameters_may_be_leaves_of_any_tree():
    """An energy with unknown coefficients is a tree, too."""
    powers = [(2, 0, 0), (0, 2, 0), (0, 0, 2)]
    energy = tj.energies.Polynomial([0.7, 40.0, 250.0], powers, coordinates="twist")
    coefficients = Parameter(energy.coefficients, "J")
    start = eqx.tree_at(lambda energy: energy.coefficients, energy, coefficients)

    def design(energy):
        hinge = tj.Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
        bodies = [tj.Body("wall"), tj.Body("block")]
        return tj.Mechanism(bodies, [hinge], fixed=["wall"])

    wrenches = [(0.1, 0, 0), (0, 1.0, 0), (0, 0, 1.0)]
    sensors = [BodySensor("block", name, 1e-5) for name in ("angle", "x", "y")]
    test = StaticTest([[tj.Load("block", wrench)] for wrench in wrenches], sensors)
    data = test.measurement(np.diag([0.1, 0.01, 0.0025]))
    result = tj.identify(design, start, [data])
    assert isinstance(result.estimates, tj.energies.Polynomial)
    expected = jnp.array([0.5, 50.0, 200.0])
    assert_close(result.estimates.coefficients, expected, digits=7)
    assert result.names == ("coefficients[0]", "coefficients[1]", "coefficients[2]")


def test_numbers_in_a_tree_of_parameters_are_constants():
    test = FormulaTest(lambda u: jnp.stack([u[0] + u[1]]), jnp.ones(1))
    start = {"a": positive(80.0), "b": 300.0}
    result = tj.identify(body_at, start, [test.measurement([[400.0]])])
    assert result.names == ("a",)
    assert result.estimates["b"] == 300.0
    assert_close(result.estimates["a"], 100.0, digits=6)
    parameters = ParameterSet.from_tree({"along": 80, "across": 300.0})
    assert parameters.names == ("across", "along")


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
