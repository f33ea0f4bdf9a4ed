"""Sampled designs have their distributions, and tolerances agree with closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, qmc
from sweep_helpers import compiled as compiled

import twistorjax as tj
from twistorjax.examples.sweep_studies import stage_gain


pytest.importorskip("xarray")


@pytest.mark.parametrize("method", ["sobol", "latin_hypercube", "random"])
def test_samples_have_their_distributions(method):
    distributions = {
        "a": tj.sweeps.Normal(2.0, 0.1),
        "b": tj.sweeps.Uniform([0.0, 1.0], [1.0, 3.0]),
        "c": 7.0,
    }

    def sample(seed):
        return tj.sweeps.sample_designs(distributions, 4000, method=method, seed=seed)

    designs = sample(3)
    assert designs["a"].shape == (4000,) and designs["b"].shape == (4000, 2)
    np.testing.assert_array_equal(designs["c"], 7.0)
    assert abs(designs["a"].mean() - 2.0) < 0.006
    assert abs(designs["a"].std() - 0.1) < 0.005
    for column, low, high in ((0, 0.0, 1.0), (1, 1.0, 3.0)):
        probabilities = np.sort((designs["b"][:, column] - low) / (high - low))
        assert np.abs(probabilities - (np.arange(4000) + 0.5) / 4000).max() < 0.03
    np.testing.assert_array_equal(sample(3)["a"], designs["a"])
    assert np.any(sample(4)["a"] != designs["a"])


def test_samples_have_the_required_correlation():
    """For normal variables; for two uniform ones that of ranks, by Pearson's formula."""
    correlation = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.0], [0.0, 0.0, 1.0]])
    distributions = {
        "a": tj.sweeps.Normal([1.0, 2.0], [0.1, 0.5]),
        "b": tj.sweeps.Uniform(0.0, 1.0),
    }
    designs = tj.sweeps.sample_designs(distributions, 8192, correlation=correlation)
    samples = np.column_stack([designs["a"], designs["b"]])
    np.testing.assert_allclose(np.corrcoef(samples.T), correlation, atol=0.01)
    uniform = {"b": tj.sweeps.Uniform(np.zeros(2), 1.0)}
    designs = tj.sweeps.sample_designs(uniform, 8192, correlation=correlation[:2, :2])
    exact = 6 / np.pi * np.arcsin(0.8 / 2)
    assert abs(np.corrcoef(designs["b"].T)[0, 1] - exact) < 0.01


def test_fully_correlated_variables_are_equal():
    distributions = {"a": tj.sweeps.Normal(np.zeros(2), 1.0)}
    designs = tj.sweeps.sample_designs(distributions, 64, correlation=np.ones((2, 2)))
    np.testing.assert_allclose(designs["a"][:, 0], designs["a"][:, 1], atol=1e-9)


def test_the_sample_of_a_point_of_zero_is_finite(monkeypatch):
    monkeypatch.setattr(qmc.Sobol, "random_base2", lambda self, m: np.zeros((2**m, 1)))
    x = tj.sweeps.sample_designs({"x": tj.sweeps.Normal(0.0, 1.0)}, 4)["x"]
    assert np.all((x < -6.0) & (x > -8.3))


@pytest.mark.slow
def test_all_samples_are_finite():
    """Sobol points have thirty bits, and one may be zero."""
    distributions = {"x": tj.sweeps.Normal(np.zeros(100), 1.0)}
    x = tj.sweeps.sample_designs(distributions, 2**17, seed=40)["x"]
    assert np.all(np.abs(x) < 8.3)


def standard_normal(size):
    return {"a": tj.sweeps.Normal(np.zeros(size), 1.0)}


@pytest.mark.untyped
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tj.sweeps.Normal(1.0, -0.1), "must not be negative"),
        (
            lambda: tj.sweeps.Normal([1.0, 2.0], [1.0, 2.0, 3.0]),
            "must have the same shape",
        ),
        (lambda: tj.sweeps.Uniform(2.0, 1.0), "`low` must not exceed `high`"),
        (lambda: tj.sweeps.Uniform(0.0, np.inf), "must be finite"),
        (lambda: tj.sweeps.sample_designs({"a": 1.0}, 8), "has no uncertain parameter"),
        (
            lambda: tj.sweeps.sample_designs({"a": tj.sweeps.Normal(0, 1)}, 0),
            "`count` is 0",
        ),
        (
            lambda: tj.sweeps.sample_designs(
                {"a": tj.sweeps.Normal(0, 1)},
                8,
                method="halton",  # pyright: ignore[reportArgumentType]
            ),
            "'sobol'",
        ),
        (
            lambda: tj.sweeps.sample_designs(
                standard_normal(2), 8, correlation=np.eye(3)
            ),
            "must be a symmetric matrix with ones on its diagonal for a[0], a[1]",
        ),
        (
            lambda: tj.sweeps.sample_designs(
                standard_normal(3), 8, correlation=1.9 * np.eye(3) - 0.9 * np.ones((3, 3))
            ),
            "negative eigenvalue",
        ),
    ],
)
def test_invalid_distributions_are_rejected(call, message):
    with pytest.raises(ValueError) as error:
        call()
    assert message in str(error.value)


def test_tolerances_of_a_linear_output_agree_with_the_closed_form(validated):
    """The variance of c . x is c . S c with the covariance S of normal variables."""
    coefficients = jnp.array([3.0, -2.0, 0.5])

    def study(design):
        return {"sum": coefficients @ design["x"], "more": design["x"]}

    deviations, correlation = np.array([0.1, 0.2, 0.3]), np.eye(3)
    correlation[0, 1] = correlation[1, 0] = 0.5
    distributions = {"x": tj.sweeps.Normal([1.0, 2.0, 3.0], deviations)}
    result = tj.sweeps.tolerances(study, distributions, "sum", correlation=correlation)
    covariance = np.outer(deviations, deviations) * correlation
    exact = np.sqrt(coefficients @ covariance @ coefficients)
    first_order = result.first_order_standard_deviation
    np.testing.assert_allclose(first_order, exact, rtol=1e-12)
    np.testing.assert_allclose(result.nominal, 0.5, rtol=1e-12)
    what = "standard deviation of a sum of three variables, first order"
    validated("Tolerances", what, first_order, exact, "closed form")
    what = "standard deviation of a sum of three variables, 8,192 sampled designs"
    validated("Tolerances", what, result.standard_deviation, exact, "closed form")
    assert abs(result.first_order_error) < 0.005
    assert abs(result.mean - 0.5) < 1e-3 * exact
    interval = norm.ppf([0.025, 0.975], 0.5, exact)
    np.testing.assert_allclose(result.percentile_interval, interval, atol=0.01)
    shares = {share.name: share for share in result.variance_shares}
    effects = np.asarray(coefficients) * deviations
    names = ("x[0]", "x[1]", "x[2]")
    for name, variance in zip(names, effects * (correlation @ effects), strict=True):
        share, exact_share = shares[name], variance / exact**2
        np.testing.assert_allclose(share.first_order, exact_share, rtol=1e-9)
        np.testing.assert_allclose(share.sampled, exact_share, atol=5e-3)
    assert "x[1]" in repr(result)


def product(design):
    return design["modulus"] * design["web"]


def test_variance_shares_do_not_depend_on_units():
    """The web is in meters and the modulus in pascals. Their relative variances add."""
    values = {"modulus": (70e9, 1e9), "web": (0.25e-3, 10e-6)}
    result = tj.sweeps.tolerances(
        product, {name: tj.sweeps.Normal(*value) for name, value in values.items()}
    )
    variances = {
        name: (deviation / mean) ** 2 for name, (mean, deviation) in values.items()
    }
    for share in result.variance_shares:
        exact = variances[share.name] / sum(variances.values())
        np.testing.assert_allclose(share.first_order, exact, rtol=1e-9)
        np.testing.assert_allclose(share.sampled, exact, atol=5e-3)
    assert result.nonlinear_share < 1e-3


@pytest.mark.parametrize("kinds", ["uu", "un", "nn"])
def test_uniform_variables_are_less_correlated_than_their_normal_variables(kinds):
    """The standard deviation of a difference agrees with a quadrature."""
    copula, deviation = 0.9, 12**-0.5
    correlation = np.array([[1.0, copula], [copula, 1.0]])
    kind = {"u": tj.sweeps.Uniform(0.0, 1.0), "n": tj.sweeps.Normal(0.5, deviation)}
    designs = {"a": kind[kinds[0]], "b": kind[kinds[1]]}
    result = tj.sweeps.tolerances(
        lambda design: design["a"] - design["b"], designs, correlation=correlation
    )
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    z, w = np.meshgrid(nodes, nodes)
    density = np.outer(weights, weights) / (2 * np.pi)
    centered = {"u": lambda x: norm.cdf(x) - 0.5, "n": lambda x: deviation * x}
    second = copula * z + np.sqrt(1 - copula**2) * w
    difference = centered[kinds[0]](z) - centered[kinds[1]](second)
    exact = np.sqrt(np.sum(density * difference**2))
    np.testing.assert_allclose(result.first_order_standard_deviation, exact, rtol=1e-4)
    np.testing.assert_allclose(result.standard_deviation, exact, rtol=2e-3)
    assert result.nonlinear_share < 1e-12


def test_the_nonlinear_share_of_the_variance_is_reported():
    """In a + 5 b^2 of standard normal variables, a has a share of 1/51, and b of 0."""
    designs = {name: tj.sweeps.Normal(0.0, 1.0) for name in "ab"}
    result = tj.sweeps.tolerances(lambda d: d["a"] + 5 * d["b"] ** 2, designs)
    shares = {share.name: share.sampled for share in result.variance_shares}
    np.testing.assert_allclose(shares["a"], 1 / 51, atol=5e-3)
    np.testing.assert_allclose(shares["b"], 0.0, atol=5e-3)
    np.testing.assert_allclose(result.nonlinear_share, 50 / 51, atol=5e-3)
    assert "nonlinear" in repr(result)


def cube(design):
    return design["x"] ** 3


@pytest.mark.parametrize("method", ["sobol", "latin_hypercube", "random"])
def test_standard_errors_agree_with_the_scatter_of_the_means(method):
    """For sixteen seeds; the scatter of Sobol's points is a hundredth of random ones."""
    designs = {"x": tj.sweeps.Normal(1.0, 0.1)}
    results = [
        tj.sweeps.tolerances(cube, designs, count=1024, method=method, seed=seed)
        for seed in range(16)
    ]
    estimated = np.median([result.mean_standard_error for result in results])
    scatter = np.std([result.mean for result in results], ddof=1)
    assert 0.6 < estimated / scatter < 1.6
    assert (scatter < 1e-3) == (method != "random")


def test_parameters_have_the_names_and_units_of_a_sweep():
    distributions = {
        "leaf": {"t": tj.sweeps.Normal(np.ones(2), 0.1)},
        "w": tj.sweeps.Uniform(1.0, 2.0),
    }

    def study(design):
        return {"area": design["leaf"]["t"].sum() * design["w"]}

    units = {"leaf.t": "m", "w": "m", "area": "m2"}
    result = tj.sweeps.tolerances(study, distributions, "area", units=units, count=64)
    assert result.table["area_by_w"].attrs["units"] == "m2/m"
    assert result.table["leaf.t"].shape == (64, 2)
    names = {share.name for share in result.variance_shares}
    assert names == {"leaf.t[0]", "leaf.t[1]", "w"}
    with pytest.raises(ValueError, match="`output` is 'volume', but the differentiable"):
        tj.sweeps.tolerances(study, distributions, "volume", count=64)
    with pytest.raises(ValueError, match="must be an integer of at least 2"):
        tj.sweeps.tolerances(study, distributions, "area", count=1)


def test_tolerances_need_double_precision():
    with jax.enable_x64(False), pytest.raises(ValueError, match="double precision"):
        tj.sweeps.tolerances(cube, {"x": tj.sweeps.Normal(1.0, 0.1)})


def test_a_study_is_compiled_once_for_several_means(compiled):
    def study(design):
        return design["x"] * design["y"]

    for mean in (1.0, 2.0):
        tj.sweeps.tolerances(study, {"x": tj.sweeps.Normal(mean, 0.1), "y": 3.0})
    assert len(compiled) == 1


def test_a_study_uses_the_values_at_the_time_of_the_call():
    """The standard deviation of a multiple is that of the variable times the factor."""
    factors = np.zeros(1)

    def study(design):
        return design["x"] * factors[0]

    for factor in (1.0, 2.0):
        factors[0] = factor
        found = tj.sweeps.tolerances(study, {"x": tj.sweeps.Normal(1.0, 0.1)})
        assert found.first_order_standard_deviation == pytest.approx(0.1 * factor)
        assert found.mean == pytest.approx(factor, rel=1e-3)


def test_sampled_designs_show_what_the_first_order_formula_misses():
    """The square of a normal variable of mean zero has no derivative at the mean."""
    result = tj.sweeps.tolerances(
        lambda design: design["x"] ** 2, {"x": tj.sweeps.Normal(0.0, 0.1)}
    )
    assert result.first_order_standard_deviation == 0.0
    np.testing.assert_allclose(result.mean, 0.01, rtol=5e-3)
    np.testing.assert_allclose(result.mean_shift, 0.01, rtol=5e-3)
    np.testing.assert_allclose(result.standard_deviation, np.sqrt(2) * 0.01, rtol=2e-2)


def test_failed_designs_are_left_out_of_the_statistics():
    def study(design):
        return jnp.sqrt(design["x"])

    designs = {"x": tj.sweeps.Normal(1.0, 0.5)}
    with pytest.warns(UserWarning, match="of 1,000 designs failed"):
        result = tj.sweeps.tolerances(study, designs, count=1000)
    assert 10 < result.failed_count < 50
    assert np.isfinite(result.standard_deviation)
    assert "designs failed" in repr(result)
    with pytest.raises(ValueError, match="at the means"):
        tj.sweeps.tolerances(study, {"x": tj.sweeps.Normal(-1.0, 0.1)}, count=8)


def test_the_output_must_be_a_scalar():
    with pytest.raises(ValueError, match="must be a scalar"):
        tj.sweeps.tolerances(
            lambda design: jnp.ones(2) * design["x"], {"x": tj.sweeps.Normal(0, 1.0)}
        )


@pytest.mark.slow
def test_tolerances_of_the_webs_propagate_to_the_gain_of_the_stage():
    """The derivatives for each web sum to that for all; their squares to the variance."""
    webs = {"web": tj.sweeps.Normal(np.full(7, 0.25e-3), 10e-6)}
    result = tj.sweeps.tolerances(stage_gain, webs, "gain", count=4096)
    derivatives = [share.derivative for share in result.variance_shares]
    np.testing.assert_allclose(sum(derivatives), -50661.2107, rtol=1e-6)
    exact = 10e-6 * np.hypot.reduce(derivatives)
    np.testing.assert_allclose(result.first_order_standard_deviation, exact, rtol=1e-9)
    assert abs(result.first_order_error) < 0.005


@pytest.mark.slow
def test_errors_of_assembly_load_an_over_constrained_guide():
    """Three leaves hold a table that needs two: their ends are not on one line.

    The middle leaf keeps a third of (2 e2 - e1 - e3), where e are the errors of the
    lengths, with the standard deviation sqrt(6) / 3 of that of one error.
    """
    length, thickness, width, deviation = 50e-3, 0.5e-3, 10e-3, 5e-6
    steel = tj.Material(210e9, poisson=0.3)
    leaf = tj.flexures.leaf(steel, length=length, thickness=thickness, width=width)

    def study(design):
        hinges = [
            tj.Hinge(
                str(k), "base", "table", leaf, (np.pi / 2, x, length / 2),
                misfit=(0.0, design["error"][k], 0.0),
            )
            for k, x in enumerate((-0.04, 0.0, 0.04))
        ]  # fmt: skip
        bodies = [tj.Body("base"), tj.Body("table", (0.0, 0.0, length))]
        mechanism = tj.Mechanism(bodies, hinges, fixed=["base"])
        solution = tj.equilibrium(mechanism, throw=False)
        stress = mechanism.wrench_of("1", solution)[1] / (thickness * width)
        return {"stress": stress, "tilt": solution.displacement("table")[0]}

    errors = {"error": tj.sweeps.Normal(np.zeros(3), deviation)}
    result = tj.sweeps.tolerances(study, errors, "stress", count=512)
    exact = 210e9 * deviation / length * np.sqrt(6) / 3
    # The leaves also bend, which reduces the force by (thickness / spacing)^2.
    np.testing.assert_allclose(result.first_order_standard_deviation, exact, rtol=1e-4)
    assert abs(result.first_order_error) < 0.02
    # The outer leaves tilt the table by (e3 - e1) / (2 spacing).
    tilt = float(result.table["tilt"].std())
    np.testing.assert_allclose(tilt, deviation / (np.sqrt(2) * 0.04), rtol=0.02)


@pytest.mark.parametrize("count", [2, 3, 15, 64])
def test_standard_error_of_a_standard_deviation_from_few_designs(count):
    """For normal variables it is the standard deviation over `sqrt(2 (count - 1))`."""
    design = {"x": tj.sweeps.Normal(1.0, 2.0)}
    result = tj.sweeps.tolerances(
        lambda d: {"o": d["x"]}, design, "o", count=count, method="random"
    )
    expected = result.standard_deviation / np.sqrt(2 * (count - 1))
    error = result.standard_deviation_standard_error
    np.testing.assert_allclose(error, expected, rtol=1e-12 if count < 16 else 0.3)


@pytest.mark.untyped
def test_tolerances_of_a_complex_output_raise_an_error():
    design = {"x": tj.sweeps.Normal(1.0, 1.0)}
    with pytest.raises(ValueError, match="'o' is complex, but must be real"):
        tj.sweeps.tolerances(
            lambda d: {"o": jax.lax.complex(0.0, d["x"])}, design, "o", count=4
        )
