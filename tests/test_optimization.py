"""Optima against closed forms, finite differences, and solvers of SciPy alone."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from helpers import assert_close
from optimization_helpers import (
    LEAF,
    leaf_parameters,
    leaf_spring,
    MODULUS,
    STRENGTH,
    TRAVEL,
    WIDTH,
)
from scipy.stats import norm
from sweep_helpers import compiled as compiled, pulled_block

import twistorjax as tj
from twistorjax.sweeps import optimize_cases


def stiffest_leaf(modulus=MODULUS, strength=STRENGTH, thickness=1e-3):
    """The thickest leaf, as short as its strength allows; N/m."""
    length = np.sqrt(1.5 * modulus * thickness * TRAVEL / strength)
    return modulus * WIDTH * thickness**3 / 4 / length**3


def test_leaf_spring_is_as_short_and_thick_as_its_limits_allow(validated):
    optimum = tj.optimize(
        leaf_spring, leaf_parameters(modulus=MODULUS), starts=20, **LEAF
    )
    assert optimum.succeeded and len(optimum.local_optima) == 1
    assert sum(len(each.starts) for each in optimum.local_optima) == 20
    exact = stiffest_leaf()
    multipliers = {each.name: each.derivative for each in optimum.active_limits}
    (by_modulus,) = optimum.sensitivities
    found = [multipliers["stress"], multipliers["thickness"], by_modulus.derivative]
    values = {"strength": STRENGTH, "thickness": 1e-3, "modulus": MODULUS}
    differences = []
    for name, value in values.items():
        ends = [stiffest_leaf(**{name: (1 + side * 1e-4) * value}) for side in (1, -1)]
        differences.append((ends[0] - ends[1]) / 2e-4)
    relative = found * np.array([*values.values()])
    np.testing.assert_allclose(optimum.objective, exact, rtol=1e-7)
    np.testing.assert_allclose(relative, differences, rtol=1e-5)
    what = "stiffest leaf spring within a stress limit"
    oracle = "closed form of beam theory"
    validated("Optimization", what, optimum.objective, exact, oracle)
    what = "multipliers of a limit and a bound, sensitivity to the modulus"
    oracle = "differences of the closed form"
    validated("Optimization", what, relative, differences, oracle)
    text = repr(optimum)
    assert "20 of 20 searches ended here" in text and "upper bound" in text
    assert "stress <= 2.5e+08" in text and "modulus" in text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:delta_grad == 0.0")
def test_searches_end_where_scipy_alone_ends():
    """A problem with several local optima, more starts than run side by side."""

    def study(design):
        x, y = design["x"], design["y"]
        wave = jnp.sin(3 * x) * jnp.cos(2 * y)
        return {"f": 0.1 * (x**2 + y**2) + wave, "radius": x**2 + y**2}

    parameters = {
        "x": tj.Parameter(1.0, lower=-3, upper=3),
        "y": tj.Parameter(1.0, lower=-3, upper=3),
    }
    limits = {"radius": tj.Limit(lower=1.0, upper=6.0)}
    found = tj.optimize(study, parameters, minimize="f", limits=limits, starts=50)
    assert len(found.local_optima) > 3

    def value(point):
        return 0.1 * point @ point + np.sin(3 * point[0]) * np.cos(2 * point[1])

    radius = scipy.optimize.NonlinearConstraint(lambda point: point @ point, 1.0, 6.0)
    bounds = [(-3, 3), (-3, 3)]
    options = {"gtol": 1e-10, "xtol": 1e-12, "maxiter": 3000, "initial_tr_radius": 1e-3}
    for end in found.searches.ends:
        alone = scipy.optimize.minimize(
            value, end + 1e-3, method="trust-constr", bounds=bounds, constraints=radius,
            options=options,
        )  # fmt: skip
        np.testing.assert_allclose(end, alone.x, atol=2e-4)
    starts = {"x": found.searches.starts[:, 0], "y": found.searches.starts[:, 1]}
    for row in (3, 41):
        single = {name: values[row : row + 1] for name, values in starts.items()}
        alone = tj.optimize(study, parameters, minimize="f", limits=limits, starts=single)
        end = found.searches.ends[row]
        np.testing.assert_allclose(alone.searches.ends[0], end, atol=1e-4)


@pytest.mark.parametrize(
    ("objective", "starts", "optimum"),
    [
        (lambda x, y: jnp.exp(x) + jnp.exp(-x) + (y - 1) ** 2, (30.0, 3.0), (0.0, 1.0)),
        (lambda x, y: 1e6 * (1 - x) ** 2 + (y - 1) ** 2, (5.0, 3.0), (1.0, 1.0)),
        (lambda x, y: 100 * (y - x**2) ** 2 + (1 - x) ** 2, (-1.2, 1.0), (1.0, 1.0)),
        (lambda x, y: x**-3 + 3 * x + (y - 1) ** 2, (0.05, 3.0), (1.0, 1.0)),
    ],
)
def test_a_large_gradient_at_the_start_has_no_effect(objective, starts, optimum):
    parameters = [tj.Parameter(start) for start in starts]
    design = dict(zip("xy", parameters, strict=True))
    found = tj.optimize(lambda d: {"f": objective(d["x"], d["y"])}, design, minimize="f")
    ends = [float(found.parameters[name]) for name in "xy"]
    np.testing.assert_allclose(ends, optimum, atol=1e-5)


def test_equality_and_array_limits():
    """The point of a plane that is nearest to the origin, off two half-spaces."""
    normal = np.array([1.0, 2.0, 2.0])

    def study(design):
        x = design["x"]
        return {"distance": jnp.sum(x**2), "height": jnp.dot(normal, x), "x": x + 0.0}

    limits = {"height": tj.Limit(9.0, 9.0), "x": tj.Limit(lower=[0.0, 2.5, 0.0])}
    optimum = tj.optimize(
        study,
        {"x": tj.Parameter(np.zeros(3), scale=1.0)},
        minimize="distance",
        limits=limits,
    )
    np.testing.assert_allclose(optimum.parameters["x"], [0.8, 2.5, 1.6], atol=1e-7)
    multipliers = {each.name: each for each in optimum.active_limits}
    # gradient 2 x = a normal + b e_y, with a = 1.6 and b = 5 - 2 a
    assert multipliers["height"].side == "equal"
    np.testing.assert_allclose(multipliers["height"].derivative, 1.6, rtol=1e-6)
    np.testing.assert_allclose(multipliers["x[1]"].derivative, 1.8, rtol=1e-6)


def test_optimum_of_a_mechanism_and_units_of_solutions():
    """The softest spring whose block moves by at most 2 mm under a known force."""

    def study(design):
        outputs = pulled_block(design)
        travel = tj.solve.Column(outputs["travel"], unit="m")
        return {**outputs, "travel": travel, "k": design["k"] + 0.0}

    parameters = {"k": tj.Parameter(5e3, "N/m", lower=100.0, upper=1e5), "force": 3.0}
    optimum = tj.optimize(
        study, parameters, minimize="k", limits={"travel": tj.Limit(upper=2e-3)}
    )
    np.testing.assert_allclose(optimum.parameters["k"], 1500.0, rtol=1e-6)
    (limit,) = optimum.active_limits
    assert limit.unit == "m" and optimum.parameters["force"] == 3.0
    np.testing.assert_allclose(limit.derivative, -1500.0 / 2e-3, rtol=1e-5)
    (by_force,) = optimum.sensitivities
    np.testing.assert_allclose(by_force.derivative, 500.0, rtol=1e-5)


def test_robust_limit_holds_with_the_stated_probability(validated):
    """A linear limit, for which first order is exact; three standard deviations."""
    slopes, deviations = np.array([3.0, 1.0, 2.0]), np.array([0.02, 0.05, 0.01])

    def study(design):
        x = jnp.concatenate([design["x"], design["c"][None]])
        return {"cost": jnp.sum(design["x"]), "load": jnp.dot(slopes, x)}

    parameters = {
        "x": tj.Parameter(np.ones(2), lower=0.0, upper=2.0),
        "c": 1.0,
    }
    limits = {"load": tj.Limit(upper=6.0)}
    certain = tj.optimize(study, parameters, maximize="cost", limits=limits)
    optimum = tj.optimize(
        study, parameters, maximize="cost", limits=limits,
        standard_deviations={"x": deviations[:2], "c": deviations[2]},
    )  # fmt: skip
    width = 3 * np.linalg.norm(slopes * deviations)
    exact = 2.0 + (6.0 - 2.0 - 2.0 - width) / 3
    np.testing.assert_allclose(certain.objective, 2.0 + 2.0 / 3, rtol=1e-7)
    by_name = {each.name: each.derivative for each in optimum.sensitivities}
    step = 3 * slopes**2 * deviations / np.linalg.norm(slopes * deviations) / 3
    np.testing.assert_allclose(by_name["standard deviation of x[1]"], -step[1], rtol=1e-5)
    np.testing.assert_allclose(by_name["c"], -2 / 3, rtol=1e-5)
    spread = dict(optimum.standard_deviations)
    shares = optimum.violations(count=100_000)
    expected = norm.sf(3.0)
    assert abs(shares.any_limit - expected) < 4 * np.sqrt(expected / 100_000)
    assert abs(certain.violations(spread).any_limit - 0.5) < 0.02
    assert "load upper" in repr(shares)
    np.testing.assert_allclose(optimum.objective, exact, rtol=1e-7)
    what = "optimum with a limit that holds at three standard deviations"
    validated("Optimization", what, optimum.objective, exact, "closed form")


def test_robust_mechanism_reacts_to_the_curvature_of_the_limit():
    """The derivative of the standard deviation needs second derivatives."""
    parameters = {"k": tj.Parameter(5e3, lower=100.0, upper=1e5), "force": 3.0}

    def study(design):
        return {**pulled_block(design), "k": design["k"] + 0.0}

    optimum = tj.optimize(
        study, parameters, minimize="k", limits={"travel": tj.Limit(upper=2e-3)},
        standard_deviations={"k": 30.0, "force": 0.1}, coverage_factor=2.0,
    )  # fmt: skip

    def margin(k):
        deviation = np.hypot(0.1 / k, 3.0 / k**2 * 30.0)
        return 2e-3 - 3.0 / k - 2.0 * deviation

    exact = scipy.optimize.brentq(margin, 1e3, 3e3, xtol=1e-10)
    np.testing.assert_allclose(optimum.parameters["k"], float(exact), rtol=1e-6)  # pyright: ignore


def test_variables_without_effect_are_named():
    def study(design):
        area = design["width"] * design["depth"]
        return {"length": design["length"], "volume": area * design["length"]}

    sizes = {
        "length": (2.0, 1.0, 9.0),
        "width": (2.0, 1.0, 3.0),
        "depth": (1.0, 0.5, 2.0),
    }
    parameters: dict[str, tj.Parameter] = {
        name: tj.Parameter(start, lower=low, upper=high)
        for name, (start, low, high) in sizes.items()
    }
    limits = {"volume": tj.Limit(lower=0.1)}
    found = tj.optimize(study, parameters, minimize="length", limits=limits, starts=4)
    assert set(found.without_effect) == {"width", "depth"}
    assert "variables without effect: " in repr(found)
    assert "searches with the same objective at other designs: 3" in repr(found)
    limits = {"volume": tj.Limit(lower=8.0)}
    found = tj.optimize(study, parameters, minimize="length", limits=limits, starts=4)
    assert not found.without_effect


def test_cases_are_points_of_the_pareto_front():
    strengths = np.array([150e6, 250e6, 400e6])
    front = optimize_cases(
        leaf_spring, leaf_parameters(), {"stress": strengths}, starts=3, **LEAF
    )
    exact = [stiffest_leaf(strength=strength) for strength in strengths]
    np.testing.assert_allclose([each.objective for each in front], exact, rtol=1e-6)
    moduli = [70e9, 210e9]
    front = optimize_cases(
        leaf_spring, leaf_parameters(modulus=1e11), {"modulus": moduli}, **LEAF
    )
    exact = [stiffest_leaf(modulus=modulus) for modulus in moduli]
    np.testing.assert_allclose([each.objective for each in front], exact, rtol=1e-6)
    assert [float(each.parameters["modulus"]) for each in front] == moduli
    row = front[0].space.names.index("modulus")
    assert [each.searches.starts[0, row] for each in front] == moduli


def test_study_is_compiled_once_for_all_calls(compiled):
    tj.optimize(leaf_spring, leaf_parameters(), starts=4, **LEAF)
    limits = {"stress": tj.Limit(upper=100e6)}
    options = {"starts": 4, "maximize": "stiffness", "limits": limits}
    tj.optimize(lambda design: leaf_spring(design), leaf_parameters(), **options)
    assert len(compiled) == 1


def test_study_uses_the_values_at_the_time_of_the_call():
    """The smallest value of (x - c)^2 is at c."""
    center = np.zeros(())

    def study(design):
        return {"distance": (design["x"] - center) ** 2}

    for value in (1.0, 2.0):
        center.fill(value)
        parameters = {"x": tj.Parameter(0.5, lower=0.0, upper=5.0)}
        optimum = tj.optimize(study, parameters, minimize="distance")
        assert float(optimum.parameters["x"]) == pytest.approx(value, abs=1e-4)


def test_finished_searches_are_not_repeated(tmp_path, monkeypatch):
    pytest.importorskip("zarr")
    from twistorjax.sweeps.optimization import searches

    store = tmp_path / "searches.zarr"
    options = {**LEAF, "starts": 6, "store": store}
    complete = tj.optimize(leaf_spring, leaf_parameters(), **LEAF, starts=6)
    write, written = searches.SearchStore.write, []

    def interrupted_write(self, row, end):
        if len(written) == 3:
            raise KeyboardInterrupt
        write(self, row, end)
        written.append(row)

    monkeypatch.setattr(searches.SearchStore, "write", interrupted_write)
    with pytest.raises(KeyboardInterrupt):
        tj.optimize(leaf_spring, leaf_parameters(), **options)
    monkeypatch.setattr(searches.SearchStore, "write", write)
    with pytest.raises(ValueError, match="already exists"):
        tj.optimize(leaf_spring, leaf_parameters(), **options)
    table = tj.sweeps.open_sweep(store)
    assert int(table.succeeded.sum()) == 3
    repeated = []
    search = searches.search
    monkeypatch.setattr(
        searches, "search", lambda *a, **k: repeated.append(a) or search(*a, **k)
    )
    resumed = tj.optimize(leaf_spring, leaf_parameters(), **options, resume=True)
    assert len(repeated) == 3
    np.testing.assert_allclose(resumed.searches.ends, complete.searches.ends, rtol=1e-9)
    table = tj.sweeps.open_sweep(store)
    np.testing.assert_array_equal(table.end, resumed.searches.ends)
    other = {**options, "limits": {"stress": tj.Limit(upper=100e6)}, "resume": True}
    with pytest.raises(ValueError, match="settings"):
        tj.optimize(leaf_spring, leaf_parameters(), **other)


def test_parts_of_an_optimization_share_their_searches(tmp_path):
    pytest.importorskip("zarr")
    options: dict[str, Any] = {**LEAF, "starts": 5, "seed": 1}
    complete = tj.optimize(leaf_spring, leaf_parameters(), **options)
    options["store"] = tmp_path / "searches.zarr"
    for k, finished in ((3, [2]), (1, [0, 2, 3]), (2, [0, 1, 2, 3, 4])):
        optimum = tj.optimize(leaf_spring, leaf_parameters(), **options, part=(k, 3))
        expected = complete.searches.ends[finished]
        np.testing.assert_allclose(optimum.searches.ends, expected, rtol=1e-9)
    np.testing.assert_allclose(optimum.objective, complete.objective, rtol=1e-9)
    with pytest.raises(ValueError, match=r"\(6, 8\), but there are only 5 searches"):
        tj.optimize(leaf_spring, leaf_parameters(), **options, part=(6, 8))


def test_searches_become_a_dataset():
    optimum = tj.optimize(leaf_spring, leaf_parameters(), starts=3, **LEAF)
    table = optimum.to_xarray()
    assert dict(table.sizes) == {"start": 3, "number": 2}
    assert list(table.number.values) == ["length", "thickness"]
    assert float(table.objective.max()) == optimum.objective


def circle_and_lines(design):
    x, y = design["x"], design["y"]
    return {
        "f": x**2 + 2 * y**2,
        "sum": x + y,
        "double": 2 * (x + y),
        "circle": x**2 + y**2,
    }


POINT = {"x": tj.Parameter(1.0), "y": tj.Parameter(3.0)}


@pytest.mark.parametrize("others", [{"double": 2.0}, {"double": 2.0, "y": 1 / 3}])
def test_redundant_prescribed_outputs(others):
    """The minimum of x^2 + 2 y^2 on x + y = 1 is (2, 1) / 3."""
    limits = {
        name: tj.Limit(lower=v, upper=v) for name, v in ({"sum": 1.0} | others).items()
    }
    best = tj.optimize(
        lambda d: circle_and_lines(d) | {"y": d["y"]}, POINT, minimize="f", limits=limits
    )
    assert_close(best.parameters["x"], 2 / 3, digits=6)
    assert_close(best.parameters["y"], 1 / 3, digits=6)


def test_limit_that_follows_from_a_prescribed_output():
    limits = {"sum": tj.Limit(1.0, 1.0), "double": tj.Limit(lower=2.0)}
    best = tj.optimize(circle_and_lines, POINT, minimize="f", limits=limits)
    assert_close(best.parameters["x"], 2 / 3, digits=6)


def test_contradictory_prescribed_outputs_have_no_feasible_design():
    limits = {"sum": tj.Limit(1.0, 1.0), "double": tj.Limit(3.0, 3.0)}
    found = tj.optimize(circle_and_lines, POINT, minimize="f", limits=limits, throw=False)
    assert tj.result_names(found.result) == "no_feasible_design"


def test_prescribed_outputs_whose_gradients_are_parallel_at_the_start():
    """At x = y the line and the circle have parallel gradients; they meet at (0, 1)."""
    limits = {"sum": tj.Limit(1.0, 1.0), "circle": tj.Limit(1.0, 1.0)}
    start = {"x": tj.Parameter(1.0), "y": tj.Parameter(1.0)}
    best = tj.optimize(circle_and_lines, start, minimize="f", limits=limits)
    points = np.array([best.parameters["x"], best.parameters["y"]])
    assert_close(np.sort(points), np.array([0.0, 1.0]), digits=6)


@pytest.mark.untyped
@pytest.mark.parametrize("limits", [None, {"f": tj.Limit(lower=0.0)}])
def test_complex_outputs_of_an_optimization_raise_an_error(limits):
    def study(design):
        return {"f": jax.lax.complex(0.0, design["x"]), "g": design["x"] ** 2}

    with pytest.raises(ValueError, match="The output 'f' is complex, but an objective"):
        tj.optimize(
            study,
            {"x": tj.Parameter(1.0)},
            minimize="g" if limits else "f",
            limits=limits,
        )
