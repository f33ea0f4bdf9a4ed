"""Unknowns of a design found from measurements, and how sure they are."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx
import pytest
import scipy.optimize
from helpers import assert_close

import twistorjax as tj
from twistorjax.examples import identification, stage


def spring(k):
    """A block on a spring: rotation, along x, along y."""
    turn, along, across = (
        jnp.asarray(k.get(name, other), float)
        for name, other in (("turn", 1.0), ("along", 100.0), ("across", 400.0))
    )
    energy = tj.Quadratic(jnp.diag(jnp.stack([turn, along, across])))
    hinge = tj.Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
    block = tj.Body("block", mass=2.0, inertia=0.1)
    return tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])


def chain(k):
    """Two springs in a row, along x."""
    stiffness = [jnp.diag(jnp.stack([1.0 + 0 * k[n], k[n], k[n]])) for n in ("a", "b")]
    first, second = (tj.Quadratic(matrix) for matrix in stiffness)
    bodies = [tj.Body("wall"), tj.Body("middle"), tj.Body("end")]
    hinges = [
        tj.Hinge("a", "wall", "middle", first, at=(0, 0, 0)),
        tj.Hinge("b", "middle", "end", second, at=(0, 0, 0)),
    ]
    return tj.Mechanism(bodies, hinges, fixed=["wall"])


def positive(value, unit=""):
    return tj.Parameter(value, unit, above=0)


def push(fx, deviation=1e-4):
    load = tj.Load("block", (0.0, fx, 0.0))
    return tj.identification.StaticTest(
        [[load]], [tj.identification.BodySensor("block", "x", deviation)]
    )


def test_a_stiffness_and_its_error_are_those_of_hooke():
    """x = F / k, so that dk = k^2 dx / F."""
    found = tj.identify(
        spring, {"along": positive(30.0, "N/m")}, [push(5.0).measured([[0.04]])]
    )
    assert_close(found.estimates["along"], 125.0, digits=7)
    assert_close(found.standard_errors["along"], 125.0**2 * 1e-4 / 5.0, digits=6)
    assert_close(found.values, jnp.array([125.0]), digits=7)


def test_many_readings_are_weighed_by_their_deviations():
    """The weighted mean of compliances, in closed form."""
    forces = np.array([1.0, 2.0, 5.0])
    readings = np.array([0.0102, 0.0199, 0.0507])
    sizes = np.array([1e-4, 2e-4, 5e-4])
    data = [
        push(force, size).measured([[reading]])
        for force, reading, size in zip(forces, readings, sizes, strict=True)
    ]
    found = tj.identify(spring, {"along": positive(80.0)}, data)
    weights = (forces / sizes) ** 2
    compliance = np.sum(weights * readings / forces) / np.sum(weights)
    assert_close(found.estimates["along"], 1 / compliance, digits=7)
    assert_close(found.covariance[0, 0], compliance**-4 / np.sum(weights), digits=5)


def test_two_unknowns_agree_with_scipy():
    """At large turns, where the model is not linear, by another's method and slopes."""
    loads = [(0.3, 20.0, 5.0), (0.6, -10.0, 30.0), (-0.2, 5.0, -25.0)]
    sensors = [
        tj.identification.BodySensor("block", "x", 1e-3, at=(0.3, 0.1)),
        tj.identification.BodySensor("block", "y", 1e-3),
    ]
    test = tj.identification.StaticTest(
        [[tj.Load("block", load)] for load in loads], sensors
    )
    true = {"turn": 1.0, "along": 100.0, "across": 400.0}
    data = test.synthetic_data(spring(true), jax.random.key(0))
    start = {"turn": positive(1.5), "along": positive(60.0)}
    found = tj.identify(spring, start, [data])

    @jax.jit
    def read(k):
        return test.read(spring({"turn": k[0], "along": k[1]}), throw=False)

    def residual(k):
        return np.ravel((read(jnp.asarray(k)) - data.values) / data.deviations)

    peer = scipy.optimize.least_squares(
        residual, [1.5, 60.0], x_scale=[1, 60], xtol=1e-15
    )
    assert_close([found.estimates[n] for n in ("turn", "along")], peer.x, digits=6)
    covariance = np.linalg.inv(peer.jac.T @ peer.jac)[::-1, ::-1]
    assert found.names == ("along", "turn")
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-4)
    size = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        found.correlations, covariance / np.outer(size, size), rtol=1e-3
    )


def test_what_is_never_stretched_is_not_determined():
    """A fit that leaves a stretch stiffness at its start says so, and gives no error."""
    test = tj.identification.StaticTest(
        [[tj.Load("block", (0.2, 0, 0))]],
        [tj.identification.BodySensor("block", "angle", 1e-3)],
    )
    start = {"turn": positive(0.5, "N m/rad"), "along": positive(77.0, "N/m")}
    found = tj.identify(spring, start, [test.measured([[0.2]])])
    assert_close(found.estimates["along"], 77.0)
    assert found.standard_errors["along"] == jnp.inf
    assert np.isfinite(found.standard_errors["turn"])
    (words,) = found.undetermined
    assert "along" in words and "turn" not in words
    assert "along" in repr(found) and "N/m  not determined" in repr(found)
    low, high = found.interval()
    assert low["along"] == 0.0 and high["along"] == jnp.inf


def test_springs_in_a_row_are_known_in_combination_alone():
    """The compliances add up: stiffening one and softening the other is not seen."""
    test = tj.identification.StaticTest(
        [[tj.Load("end", (0, 1.0, 0))]], [tj.identification.BodySensor("end", "x", 1e-5)]
    )
    start = {"a": positive(100.0), "b": positive(300.0)}
    found = tj.identify(chain, start, [test.measured([[0.02]])])
    a, b = found.estimates["a"], found.estimates["b"]
    assert_close(1 / a + 1 / b, 0.02, digits=7)
    (words,) = found.undetermined
    # d ln a / a = - d ln b / b keeps the sum
    direction = np.linalg.svd(np.asarray(found.sensitivity))[2][-1]
    assert_close(direction[0] / direction[1], -a / b, digits=6)
    assert "a by" in words and "b by" in words and "together" in words


def test_what_is_hardly_seen_is_not_determined_either():
    weak = tj.identification.StaticTest(
        [[tj.Load("block", (0.0, 1e-3, 0.0))]],
        [tj.identification.BodySensor("block", "x", 1e-3)],
    )
    found = tj.identify(spring, {"along": positive(100.0)}, [weak.measured([[1e-5]])])
    (words,) = found.undetermined
    assert "along by +1 % changes the readings by 0.0001 standard" in words
    assert "not determined" in repr(found)


def test_frequencies_tell_stiffnesses():
    """The square root of stiffness over mass, over two pi."""
    test = tj.identification.VibrationTest(3, [0.01, 0.02, 0.03])
    true = {"turn": 1.0, "along": 100.0, "across": 400.0}
    exact = np.sqrt([1.0 / 0.1, 100 / 2.0, 400 / 2.0]) / (2 * np.pi)
    start = {name: positive(1.3 * value) for name, value in true.items()}
    found = tj.identify(spring, start, [test.measured(exact[:, None])])
    for name, value in true.items():
        assert_close(found.estimates[name], value, digits=7)
    for (name, value), size, here in zip(
        true.items(), (0.01, 0.02, 0.03), exact, strict=True
    ):
        assert_close(found.standard_errors[name], 2 * value * size / here, digits=5)


def test_wrenches_of_a_hinge_are_data_too():
    trials = tj.energies.Trials(
        [[0.0, 0.01, 0.0], [0.0, 0.02, 0.0]],
        [[0.0, 1.1, 0.0], [0.0, 2.0, 0.0]],
        wrench_deviations=[0.1, 0.1, 0.1],
    )
    data = tj.identification.HingeTest.of("spring", trials)
    found = tj.identify(spring, {"along": positive(50.0)}, [data])
    assert_close(found.estimates["along"], (0.011 + 0.04) / 5e-4, digits=6)


def test_a_reading_may_be_missing():
    load = tj.Load("block", (0, 5e-6, 8e-6))  # so small that neither turns the block
    sensors = [tj.identification.BodySensor("block", name, 1e-10) for name in ("x", "y")]
    test = tj.identification.StaticTest([[load]], sensors)
    start = {"along": positive(50.0), "across": positive(500.0)}
    found = tj.identify(spring, start, [test.measured([[4e-8, np.nan]])])
    assert_close(found.estimates["along"], 125.0, digits=7)
    assert found.readings == 1
    assert "across" in found.undetermined[0]


def motion(deviation=1e-5, tolerance=1e-8):
    times = np.linspace(0.0, 1.0, 21)
    sensors = [
        tj.identification.BodySensor("block", name, deviation)
        for name in ("angle", "x", "y")
    ]
    return tj.identification.MotionTest(
        times, sensors, velocities={"block": (1.0, 0.3, 0.2)}, tolerance=tolerance
    )


@pytest.fixture(scope="module")
def swing():
    """A motion, what it starts from, and what is found from it."""
    true = {"turn": 1.0, "along": 100.0, "across": 400.0}
    data = motion().synthetic_data(spring(true), jax.random.key(3))
    start = {"turn": positive(1.2), "along": positive(80.0), "across": positive(500.0)}
    return true, data, start, tj.identify(spring, start, [data])


def test_a_motion_tells_all_three_stiffnesses(swing):
    true, _, _, found = swing
    for name, value in true.items():
        gap = abs(found.estimates[name] - value)
        assert gap < 4 * found.standard_errors[name] < 0.02 * value
    assert not found.warnings
    rms = np.sqrt(np.mean(np.square(found.residuals[0])))
    assert 0.7 < rms < 1.3
    # the slopes, by differences of motions
    problem = found.problem
    step = 1e-4
    for k in range(3):
        away = jnp.zeros(3).at[k].set(step)
        ends = [problem.residual(found.place + side * away) for side in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step)
        scale = np.max(np.abs(slope))
        np.testing.assert_allclose(found.sensitivity[:, k], slope, atol=1e-4 * scale)


def test_slopes_in_reverse_are_those_forwards(swing):
    found = swing[-1]
    forward = found.problem.found(found.place + 0.01)
    reverse = found.problem.found(found.place + 0.01, forward=False)
    np.testing.assert_allclose(reverse.slopes, forward.gradient, rtol=1e-7)


@pytest.mark.parametrize(
    "method",
    [optax.sgd(0.5), optax.adam(0.05), optx.LevenbergMarquardt(1e-9, 1e-9),
     optx.Dogleg(1e-9, 1e-9)],
    ids=["sgd", "adam", "marquardt", "dogleg"],
)  # fmt: skip
def test_every_method_finds_the_same(method):
    data = [push(force).measured([[force / 125.0]]) for force in (1.0, 5.0)]
    found = tj.identify(
        spring, {"along": positive(60.0)}, data, method=method, throw=False
    )
    assert_close(found.estimates["along"], 125.0, digits=4)


def test_gradient_descent_may_go_in_reverse():
    data = [push(5.0).measured([[0.04]])]
    start = {"along": positive(100.0)}
    found = tj.identify(
        *(spring, start, data), method=optax.adam(0.02), reverse=True, max_steps=400,
        throw=False,
    )  # fmt: skip
    assert_close(found.estimates["along"], 125.0, digits=4)
    assert_close(found.standard_errors["along"], 125.0**2 * 1e-4 / 5.0, digits=3)


def test_an_outlier_is_borne_by_a_robust_loss():
    forces = np.linspace(1.0, 5.0, 9)
    readings = forces / 100 + 1e-4 * np.array([0, 1, -1, 0.5, 300, -0.5, 1, -1, 0])
    sensors = [tj.identification.BodySensor("block", "x", 1e-4)]
    test = tj.identification.StaticTest(
        [[tj.Load("block", (0, f, 0))] for f in forces], sensors
    )
    data = [test.measured(readings[:, None])]
    start = {"along": positive(80.0)}
    plain = tj.identify(spring, start, data)
    robust = tj.identify(spring, start, data, robust=1.345)
    assert abs(plain.estimates["along"] - 100) > 5
    assert abs(robust.estimates["along"] - 100) < 0.3
    assert any("times as large as the deviations" in text for text in plain.warnings)

    def huber(k):
        z = np.abs(forces / k - readings) / 1e-4
        return np.sum(np.where(z < 1.345, z**2 / 2, 1.345 * (z - 1.345 / 2)))

    peer = scipy.optimize.minimize_scalar(huber, (90, 100, 110), tol=1e-12)
    assert_close(robust.estimates["along"], peer.x, digits=5)
    assert_close(robust.loss, peer.fun, digits=8)
    assert any("far off: block.x in row 4 by -3" in text for text in robust.warnings)
    assert not any("times as large" in text for text in robust.warnings)
    assert_close(robust.residuals[0][4, 0], (forces[4] / peer.x - readings[4]) / 1e-4,
                 digits=5)  # fmt: skip


def test_of_several_starts_the_best_is_taken():
    """Of a swing of three periods, a fit that starts a period off stays there."""
    times = np.linspace(0.0, 3.0, 25)
    let_go = {"velocities": {"block": (0.0, 1.0, 0.0)}, "tolerance": 1e-5}
    test = tj.identification.MotionTest(
        times, [tj.identification.BodySensor("block", "x", 1e-3)], **let_go
    )
    data = test.measured(np.sin(np.sqrt(50.0) * times)[:, None] / np.sqrt(50.0))
    start = {"along": positive(190.0)}
    alone = tj.identify(spring, start, [data], throw=False)
    several = tj.identify(spring, start, [data], restarts=8, spread=0.7, throw=False)
    assert abs(alone.estimates["along"] / 100 - 1) > 0.1
    assert_close(several.estimates["along"], 100.0, digits=3)
    assert several.losses.shape == (9,)
    assert any("starts ended at a larger residual" in text for text in several.warnings)


def test_a_bound_holds_and_is_told():
    data = [push(5.0).measured([[0.04]])]
    start = {"along": tj.Parameter(60.0, above=0, below=100.0)}
    found = tj.identify(spring, start, data, throw=False)
    assert 99.9 < found.estimates["along"] <= 100.0
    assert any("runs into its bound" in text for text in found.warnings)


def test_held_out_readings_judge_a_model():
    data = [push(5.0).measured([[0.04]])]
    fresh = [push(10.0).measured([[0.09]])]  # 10 / 125 is 0.08
    found = tj.identify(spring, {"along": positive(60.0)}, data, held_out=fresh)
    assert_close(found.held_out[0][0, 0], -0.01 / 1e-4, digits=6)
    assert any("held-out readings are missed" in text for text in found.warnings)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """Of 400 noisy repetitions, side by side; three standard deviations of the count."""
    forces = jnp.linspace(1.0, 5.0, 5)
    sensors = [tj.identification.BodySensor("block", "x", 1e-3)]
    test = tj.identification.StaticTest(
        [[tj.Load("block", (0, f, 0))] for f in forces], sensors
    )

    def fixed(key):
        noise = 1e-3 * jax.random.normal(key, (5, 1))
        data = test.measured(forces[:, None] / 100.0 + noise)
        found = tj.identify(spring, {"along": positive(70.0)}, [data], throw=False)
        low, high = found.interval()
        return (low["along"] < 100.0) & (high["along"] > 100.0), found.succeeded

    inside, done = jax.jit(jax.vmap(fixed))(jax.random.split(jax.random.key(5), 400))
    assert jnp.all(done)
    assert abs(np.mean(np.asarray(inside)) - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 400)


def test_a_start_without_an_answer_says_what_the_solve_says():
    data = [push(5.0).measured([[0.04]])]
    follower = tj.identification.StaticTest(
        [[tj.Load("block", (20.0, 0.0, 0.0))]],
        [tj.identification.BodySensor("block", "angle", 1e-3)],
    )
    with pytest.raises(RuntimeError, match=r"has no answer.*No equilibrium was found"):
        tj.identify(spring, {"turn": positive(1.0)}, [follower.measured([[1.0]]), *data])


def test_a_search_turns_back_where_there_is_no_answer():
    """The moment of the twistor's spring is 2 k at most: softer ones cannot bear it."""
    test = tj.identification.StaticTest(
        [[tj.Load("block", (1.9, 0.0, 0.0))]],
        [tj.identification.BodySensor("block", "angle", 1e-3)],
    )
    angle = 2 * np.arcsin(1.9 / 2 / 2 / 0.96) * 1.0
    true = 1.9 / 2 / np.sin(angle / 2) / np.cos(angle / 2)
    found = tj.identify(spring, {"turn": positive(8.0)}, [test.measured([[angle]])])
    assert_close(found.estimates["turn"], true, digits=5)


def test_not_settling_is_told():
    data = [push(5.0).measured([[0.04]])]
    with pytest.raises(RuntimeError, match=r"have not settled.*2 evaluations"):
        tj.identify(spring, {"along": positive(1.0)}, data, max_steps=2)
    found = tj.identify(spring, {"along": positive(1.0)}, data, max_steps=2, throw=False)
    assert tj.result_names(found.result) == "not_converged"
    assert "have not settled" in repr(found)


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"start": {}}, "must have something to find"),
        ({"data": []}, "`data` is empty"),
        ({"data": push(5.0)}, "StaticTest|sequence|list"),
        ({"data": [push(5.0)]}, r"`data\[0\]` is a StaticTest"),
        ({"method": "adam"}, "`method` is 'adam', but must be an optimiser"),
        ({"robust": 0.0}, "`robust` is 0.0, but must be a positive number"),
        ({"robust": True}, "`robust` is True, but must be a positive number"),
        ({"restarts": 2, "key": "a"}, "`key` is 'a', but must be a whole number"),
        ({"restarts": 2, "key": 10**20}, "`key` is 100000000000000000000, but must be"),
        ({"restarts": -1}, "`restarts` is -1"),
        ({"max_steps": 0}, "`max_steps` is 0, but must be at least 1"),
    ],
)
def test_what_cannot_be_fitted_is_refused(wrong, message):
    given = {"start": {"along": positive(1.0)}, "data": [push(5.0).measured([[0.04]])]}
    given |= wrong
    with pytest.raises((ValueError, TypeError), match=message):
        tj.identify(spring, given.pop("start"), given.pop("data"), **given)


def test_unknowns_stay_within_their_bounds_and_start_where_told():
    for bounds in ({"above": 0}, {"below": 3}, {"above": -1, "below": 3}, {}):
        unknown = tj.Parameter(2.0, **bounds)
        assert_close(unknown.at(jnp.zeros(())), 2.0, digits=12)
        slope = jax.grad(unknown.at)(jnp.zeros(()))
        assert_close(slope, unknown._size(), digits=9)
        for step in (-30.0, 30.0):
            there = unknown.at(jnp.asarray(step))
            assert there >= bounds.get("above", -jnp.inf)
            assert there <= bounds.get("below", jnp.inf)


def test_a_design_that_cannot_be_compiled_is_refused():
    data = [push(5.0).measured([[0.04]])]

    def branching(k):
        return spring({"along": k["along"] if k["along"] > 0 else 1.0})

    start = {"along": positive(1.0)}
    with pytest.raises(ValueError, match="`design` is a function that cannot be comp"):
        tj.identify(branching, start, data)
    with pytest.raises(ValueError, match="`design` gave a dict, but must build a"):
        tj.identify(lambda k: k, start, data)


def test_a_weak_unknown_keeps_no_other_from_its_best():
    """The thickness of a leaf beside a damping of which hardly anything is seen."""
    forces = np.array([1.0, 2.0, 5.0])
    sensors = [
        tj.identification.BodySensor("block", "x", 3e-3),
        tj.identification.BodySensor("block", "angle", 3.0),
    ]
    loads = [[tj.Load("block", (1e-3, f, 0.0))] for f in forces]
    test = tj.identification.StaticTest(loads, sensors)
    true = {"along": 100.0, "turn": 1.0}
    data = [test.synthetic_data(spring(true))]
    start = {"along": positive(90.0), "turn": positive(2.0)}
    found = tj.identify(spring, start, data)
    assert_close(found.estimates["along"], 100.0, digits=3)
    assert "turn" in found.undetermined[0] and "along" not in found.undetermined[0]


def test_intervals_have_a_level():
    found = tj.identify(spring, {"along": positive(80.0)}, [push(5.0).measured([[0.05]])])
    low, high = found.interval(0.6826894921)
    size = found.standard_errors["along"] / 100.0
    assert_close(low["along"], 100 * np.exp(-size), digits=6)
    assert_close(high["along"], 100 * np.exp(size), digits=6)
    with pytest.raises(ValueError, match=r"`level` is 95.0, but must be between 0 and 1"):
        found.interval(95.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((1.0,), {"above": 4, "below": 0}), "are the bounds exchanged"),
        (((-1.0,), {"above": 0}), "starts at -1.0, but must start above 0"),
        (((0.0,), {"above": 0}), "must start above 0"),
        (((4.0,), {"above": 0, "below": 4}), "must start above 0 and below 4"),
        (((jnp.nan,), {}), "must be finite"),
        (((0.0,), {}), "its size cannot be seen: give its `scale`"),
        (((1.0,), {"above": 0, "scale": 1.0}), "leave out `scale`"),
        (((np.ones(2), ("N",)), {}), "`unit` has 1 entries"),
    ],
)
def test_unknowns_that_make_no_sense_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        tj.Parameter(*arguments[0], **arguments[1])


def test_unknowns_may_be_any_tree():
    """An energy with unknown coefficients, say, and a scale that is known."""
    powers = [(2, 0, 0), (0, 2, 0), (0, 0, 2)]
    first = tj.energies.Polynomial([0.7, 40.0, 250.0], powers, coordinates="twist")
    unknown = tj.Parameter(first.coefficients, "J")
    start = eqx.tree_at(lambda energy: energy.coefficients, first, unknown)

    def design(energy):
        hinge = tj.Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
        bodies = [tj.Body("wall"), tj.Body("block")]
        return tj.Mechanism(bodies, [hinge], fixed=["wall"])

    loads = [(0.1, 0, 0), (0, 1.0, 0), (0, 0, 1.0)]
    sensors = [
        tj.identification.BodySensor("block", name, 1e-5) for name in ("angle", "x", "y")
    ]
    test = tj.identification.StaticTest(
        [[tj.Load("block", load)] for load in loads], sensors
    )
    data = test.measured(np.diag([0.1, 0.01, 0.0025]))
    found = tj.identify(design, start, [data])
    assert isinstance(found.estimates, tj.energies.Polynomial)
    assert_close(found.estimates.coefficients, jnp.array([0.5, 50.0, 200.0]), digits=7)
    assert found.names == ("coefficients[0]", "coefficients[1]", "coefficients[2]")


def test_numbers_beside_unknowns_are_known():
    data = [push(5.0).measured([[0.04]])]
    found = tj.identify(spring, {"along": positive(80.0), "across": 300.0}, data)
    assert found.names == ("along",)
    assert found.estimates["across"] == 300.0
    found = tj.identify(spring, {"along": 80, "across": 300.0}, data)
    assert found.names == ("across", "along")


class Formula(tj.identification.AbstractTest):
    """Reads any function of two unknowns, which stand in the place of a body."""

    function: Callable = eqx.field(static=True)
    sizes: jax.Array

    @property
    def columns(self):
        return ("value",)

    @property
    def units(self):
        return ("",)

    @property
    def deviations(self):
        return self.sizes[:, None]

    def read(self, mechanism, *, forward=True, throw=True):
        return self.function(mechanism.reference[1, 1:])[:, None]


def placed(u):
    body = tj.Body("block", pose=(0.0, u["a"], u["b"]))
    energy = tj.Quadratic(jnp.eye(3))
    hinge = tj.Hinge("spring", "wall", "block", energy, at=(0, 0, 0))
    return tj.Mechanism([tj.Body("wall"), body], [hinge], fixed=["wall"])


def fit_formula(function, sizes, start, **settings):
    sizes = jnp.asarray(sizes, float)
    test = Formula(function, sizes)
    free = {name: tj.Parameter(value) for name, value in start.items()}
    data = [test.measured(jnp.zeros((len(sizes), 1)))]
    return tj.identify(placed, free, data, **settings)


def test_a_reading_that_cannot_be_met_does_not_hold_up_the_others():
    """One misses by a million deviations, whatever the unknowns are."""

    def function(u):
        return jnp.stack([0 * u[0] + 1e6, u[0] - 1.0, u[0] + u[1] - 3.0, u[1] - 2.1])

    found = fit_formula(function, [1.0, 1e-4, 0.1, 0.1], {"a": 1.1, "b": 3.0})
    assert_close(found.estimates["a"], 1.0, digits=6)
    assert_close(found.estimates["b"], 2.05, digits=5)


def test_a_free_unknown_may_grow_a_thousandfold():
    found = fit_formula(
        lambda u: jnp.stack([u[0] - 1.0, u[1] - 2.0]), [0.1, 0.1], {"a": 1e-3, "b": 1.0}
    )
    assert_close(found.estimates["a"], 1.0, digits=6)
    assert not found.undetermined  # for 0.1 is a tenth of what it is now


def test_to_end_where_there_is_no_answer_is_not_to_settle():
    def function(u):
        nowhere = jnp.where(u[0] > 1.5, jnp.nan, 0.0)
        return jnp.stack([u[0] - 3.0 + nowhere, u[1] - 0.3, u[0] * u[1] ** 2 - 0.9])

    found = fit_formula(function, 3 * [1e-3], {"a": 1.0, "b": 1.0}, throw=False)
    assert tj.result_names(found.result) == "not_converged"


def test_robust_errors_are_never_better_than_those_of_least_squares():
    """Not even where every reading is far off, or all are met exactly."""
    readings = jnp.array([1.0, 1.01, 2.0, 2.01])

    def apart(u):
        return jnp.concatenate([readings - u[0], jnp.stack([u[1] - 1.0, u[1] - 1.0])])

    sizes, start = 6 * [0.1], {"a": 1.2, "b": 1.1}
    plain = fit_formula(apart, sizes, start)
    robust = fit_formula(apart, sizes, start, robust=1.345)
    for name in start:
        assert robust.standard_errors[name] > 0.999 * plain.standard_errors[name] > 0.04


def test_robust_intervals_hold_the_truth_with_few_readings():
    """Twelve of a line, one in ten of them sixfold off: 300 repetitions."""
    along = jnp.linspace(0.0, 1.0, 12)

    def fixed(key):
        noise, which = jax.random.split(key)
        size = jnp.where(jax.random.uniform(which, (12,)) < 0.1, 6.0, 1.0)
        values = 1.0 + 2.0 * along + 0.1 * size * jax.random.normal(noise, (12,))
        test = Formula(lambda u: u[0] + u[1] * along, 0.1 * jnp.ones(12))
        start = {"a": tj.Parameter(1.3), "b": tj.Parameter(1.7)}
        data = [test.measured(values[:, None])]
        found = tj.identify(placed, start, data, robust=1.345, throw=False)
        low, high = found.interval()
        return (low["b"] < 2.0) & (high["b"] > 2.0)

    inside = jax.jit(jax.vmap(fixed))(jax.random.split(jax.random.key(1), 300))
    assert abs(np.mean(np.asarray(inside)) - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 300)


def test_the_stage_tells_its_web_and_nothing_of_its_modulus():
    alone = identification.stage_web(compression=False)
    gain = stage.amplify(stage.microstage(alone.estimates["web"])).gain
    assert_close(gain, 27.95, digits=7)
    # 0.15 of the gain, by its slope of -50661 /m at 250 um
    assert 2.5e-6 < alone.standard_errors["web"] < 3.5e-6
    both = identification.stage_web()
    assert both.standard_errors["modulus"] == jnp.inf
    assert "modulus" in both.undetermined[0] and "web" not in both.undetermined[0]
    assert any("12.8 times as large" in text for text in both.warnings)


@pytest.mark.slow
def test_the_motion_of_a_linkage_tells_the_stiffnesses_of_one_hinge():
    exact = identification.hinge_a()
    for name, value in identification.LEAF.items():
        assert abs(exact.estimates[name] / value - 1) < 1e-6
    noisy = identification.hinge_a(jax.random.key(0))
    for name, value in identification.LEAF.items():
        gap = abs(noisy.estimates[name] - value)
        assert gap < 4 * noisy.standard_errors[name]
    assert not noisy.warnings


@pytest.mark.long
def test_a_bench_of_three_leaves_tells_what_beam_theory_says():
    found = identification.leaf_on_bench(jax.random.key(2))
    for name, part in found.estimates.items():
        assert abs(part - 1) < 4 * found.standard_errors[name]
    assert found.standard_errors["turn_shortens"] < 2e-3
    assert found.standard_errors["shift_shortens"] < 5e-3


@pytest.mark.long
def test_twelve_stiffnesses_are_told_by_a_camera_and_the_drives_moment():
    found = identification.twelve(jax.random.key(1))
    true = {"A": [0.071875, 862500.0, 2156.25], "D": [0.14375, 1.725e6, 17250.0]}
    for name, row in true.items():
        gap = np.abs(found.estimates[name] - np.array(row))
        assert np.all(gap < 4 * np.asarray(found.standard_errors[name]))
    assert found.standard_errors["A"][0] > 0.1 * true["A"][0]  # hardly told apart
