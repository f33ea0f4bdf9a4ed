"""Optimizations that fail, and arguments that are not valid."""

import threading

import jax.numpy as jnp
import numpy as np
import pytest
from optimization_helpers import LEAF, leaf_parameters, leaf_spring
from sweep_helpers import spring

import twistorjax as tj
from twistorjax.sweeps import optimize_cases


def test_failing_designs_shorten_the_step():
    """The root is not finite beyond the bound of its argument."""

    def study(design):
        return {"f": -design["x"] + 0.01 / jnp.sqrt(1.0 - design["x"])}

    optimum = tj.optimize(study, {"x": tj.Parameter(0.5)}, minimize="f")
    np.testing.assert_allclose(1 - optimum.parameters["x"], 0.005 ** (2 / 3), rtol=1e-4)
    with pytest.raises(RuntimeError, match=r"1 not_finite.*a solve fails"):
        tj.optimize(study, {"x": tj.Parameter(2.0)}, minimize="f")
    starts = {"x": np.array([2.0, 0.5])}
    optimum = tj.optimize(study, {"x": tj.Parameter(0.5)}, minimize="f", starts=starts)
    assert optimum.local_optima[0].starts == (1,)
    assert "searches without an optimum: 1 not_finite" in repr(optimum)


def test_limits_that_exclude_each_other_are_reported():
    limits = {"stress": tj.Limit(upper=1e6), "stiffness": tj.Limit(lower=1e6)}
    with pytest.raises(RuntimeError, match="No search ended at a design within all"):
        tj.optimize(leaf_spring, leaf_parameters(), minimize="mass", limits=limits)
    found = tj.optimize(
        leaf_spring, leaf_parameters(), minimize="mass", limits=limits, throw=False
    )
    assert not found.succeeded and np.isnan(found.objective)
    assert found.result == tj.RESULTS.no_feasible_design


@pytest.mark.slow
def test_error_of_a_study_ends_all_searches():
    def study(design):
        load = tj.Load("block", force=(3.0, 0.0))
        solution = tj.equilibrium(spring(design), loads=[load])
        return {"travel": solution.displacement("block")[1]}

    before = threading.active_count()
    parameters = {"k": tj.Parameter(1.0, lower=-10.0, upper=10.0)}
    with pytest.raises(RuntimeError, match=r"throw=False"):
        tj.optimize(study, parameters, maximize="travel", starts=8)
    assert threading.active_count() <= before + 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"maximize": None}, "Give one of them"),
        ({"minimize": "mass"}, "Give one of them"),
        ({"maximize": "weight"}, r"`maximize` is 'weight'.*stiffness"),
        ({"limits": {"weight": tj.Limit(upper=1.0)}}, r"`limits` names 'weight'"),
        ({"units": {"weight": "kg"}}, "`units` names 'weight'"),
        ({"limits": {"stress": tj.Limit(upper=[1.0, 2.0])}}, r"shape \(2,\)"),
        ({"starts": 0}, "at least 1"),
        ({"starts": 2.5}, "at least 1"),
        ({"starts": {"length": [0.03]}}, "'thickness'"),
        ({"starts": {"length": [0.1], "thickness": [1e-3]}}, "between 0.02 and 0.06"),
        ({"tolerance": 0.0}, "between 0 and 1"),
        ({"max_steps": 0}, "at least 1"),
        ({"coverage_factor": -1.0}, "positive"),
        ({"resume": True}, "there is no `store`"),
        ({"standard_deviations": {"width": 1.0}}, "'width'"),
        ({"standard_deviations": {"length": -1.0}}, "not negative"),
        ({"standard_deviations": {"length": 0.0}}, "zero"),
        (
            {
                "standard_deviations": {"length": 1e-3},
                "limits": {"stress": tj.Limit(1e6, 1e6)},
            },
            "prescribes",
        ),
    ],
)
def test_arguments_that_are_not_valid_are_explained(changes, message):
    with pytest.raises(ValueError, match=message):
        tj.optimize(leaf_spring, leaf_parameters(), **{**LEAF, **changes})


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"limits": {"stress": 1e6}}, "must be a `Limit`"),
        ({"standard_deviations": 5e-6}, "`standard_deviations` is 5e-06.* a mapping"),
        ({"starts": "8"}, "`starts` is '8', but must be a number, or a mapping"),
        ({"starts": [{"length": 0.03}]}, "`starts` is .*, but must be a number, or a"),
    ],
)
def test_arguments_of_a_wrong_type_are_explained(changes, message):
    with pytest.raises(ValueError, match=message):
        tj.optimize(leaf_spring, leaf_parameters(), **{**LEAF, **changes})


def test_a_value_that_is_not_finite_is_reported():
    """The root has an infinite derivative at zero."""
    with pytest.raises(RuntimeError, match=r"1 not_finite\. .*derivative is not finite"):
        tj.optimize(
            lambda design: {"f": jnp.sqrt(jnp.maximum(design["x"] - 1.0, 0.0))},
            {"x": tj.Parameter(0.5)},
            minimize="f",
        )


def test_other_arguments_that_are_not_valid():
    with pytest.raises(ValueError, match="lacks one"):
        tj.optimize(leaf_spring, {"length": 0.04, "thickness": 5e-4}, starts=2, **LEAF)
    with pytest.raises(ValueError, match="needs a variable"):
        tj.optimize(leaf_spring, {"length": 4}, **LEAF)
    with pytest.raises(ValueError, match="must not exceed"):
        tj.Limit(2.0, 1.0)
    with pytest.raises(ValueError, match="empty"):
        tj.Limit()
    with pytest.raises(ValueError, match="finite"):
        tj.Limit(upper=np.inf)
    with pytest.raises(ValueError, match="must name a limited output"):
        optimize_cases(leaf_spring, leaf_parameters(), {"width": [1.0]}, **LEAF)
    with pytest.raises(ValueError, match="one number for each case"):
        optimize_cases(leaf_spring, leaf_parameters(), {}, **LEAF)
    with pytest.raises(ValueError, match="No parameter is uncertain"):
        tj.optimize(leaf_spring, leaf_parameters(), **LEAF).violations()
