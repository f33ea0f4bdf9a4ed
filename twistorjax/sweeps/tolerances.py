"""Tolerance analysis: how the uncertainty of parameters propagates to an output."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.memory import require_memory
from .._utils.progress import announced
from .._utils.types import ArrayOfNumbers
from .._utils.validation import quote, require_float64
from ..designs.distributions import (
    AbstractDistribution as AbstractDistribution,
    Normal as Normal,
    Uniform as Uniform,
)
from ..designs.sampling import DistributionSet, Method
from ..designs.vector_layout import VectorLayout
from .outputs import without_jit
from .sweep import require_packages, sweep, warn_of_failures


if TYPE_CHECKING:
    import xarray


# number of independent samples, whose differences give the standard errors
_REPLICATES = 8
_FEWEST_FOR_FOURTH_MOMENT = 16  # designs of a single sample


class VarianceShare(NamedTuple):
    """Share of one random variable in the variance of an output.

    The shares of correlated variables include their covariance with the others, so they
    may be negative or exceed 1. Fully correlated variables have equal sampled shares.

    Args:
        name: Name of the variable, which is a parameter or an entry of a parameter.
        derivative: Derivative of the output with respect to the variable, at the means.
        first_order: Share of the first-order variance.
        sampled: Share of the variance of the sampled designs, by the linear function of
            the variables that fits their outputs best.
    """

    name: str
    derivative: float
    first_order: float
    sampled: float


class Tolerances(NamedTuple):
    """Distribution of an output, to first order and from sampled designs.

    Standard deviations, standard errors and percentiles are in the unit of the output.

    Args:
        output: Name of the output.
        unit: Unit of the output; empty if it is unknown.
        nominal: Output at the means of the parameters.
        first_order_standard_deviation: Standard deviation to first order, from the exact
            derivatives at the means.
        mean: Mean of the sampled designs.
        mean_standard_error: Standard error of `mean`.
        standard_deviation: Standard deviation of the sampled designs.
        standard_deviation_standard_error: Standard error of `standard_deviation`.
        percentile_interval: 2.5th and 97.5th percentile of the sampled designs.
        variance_shares: Shares of the random variables in the variance, the largest
            first.
        nonlinear_share: Share of the variance of the sampled designs that no linear
            function of the variables explains.
        failed_count: Number of sampled designs that failed. They are left out.
        table: Dataset of the sampled designs, as `sweep` returns it.
    """

    output: str
    unit: str
    nominal: float
    first_order_standard_deviation: float
    mean: float
    mean_standard_error: float
    standard_deviation: float
    standard_deviation_standard_error: float
    percentile_interval: tuple[float, float]
    variance_shares: tuple[VarianceShare, ...]
    nonlinear_share: float
    failed_count: int
    table: "xarray.Dataset"

    @property
    def first_order_error(self) -> float:
        """Relative error of the first-order standard deviation.

        The reference is the standard deviation of the sampled designs. An error well
        above `standard_deviation_standard_error / standard_deviation` shows that the
        output is nonlinear over the tolerances.
        """
        if not self.standard_deviation:
            return 0.0
        return self.first_order_standard_deviation / self.standard_deviation - 1

    @property
    def mean_shift(self) -> float:
        """Difference of the mean and the nominal output; zero for a linear study."""
        return self.mean - self.nominal

    def __repr__(self) -> str:
        unit = "" if self.unit in ("", "1") else f" {self.unit}"

        def row(label: str, mean: float, deviation: float, digits: int) -> str:
            numbers = f"{mean:>12.{digits + 2}g}  {deviation:>12.{digits}g}"
            return f"{label:<14}  {numbers}{unit}"

        count = self.table.sizes["design"]
        low, high = self.percentile_interval
        errors = (self.mean_standard_error, self.standard_deviation_standard_error)
        lines = [
            f"{self.output} of {count - self.failed_count:,} sampled designs",
            f"{'':<14}  {'mean':>12}  {'std. dev.':>12}",
            row("first order", self.nominal, self.first_order_standard_deviation, 4),
            row("sampled", self.mean, self.standard_deviation, 4),
            row("standard error", *errors, 2),
            f"95 % interval: {low:.6g} to {high:.6g}{unit}",
            f"shift of the mean: {self.mean_shift:.2g}{unit}; error of the first-order "
            f"std. dev.: {100 * self.first_order_error:.2g} %",
        ]
        if self.failed_count:
            lines.append(f"warning: {self.failed_count:,} designs failed")
        width = max(9, *(len(share.name) for share in self.variance_shares))
        lines += [
            f"{'':<{width}}  {'':>12}  {'share of variance':>22}",
            f"{'parameter':<{width}}  {'derivative':>12}  {'first order':>11}  "
            f"{'sampled':>9}",
        ]
        for name, derivative, first_order, sampled in self.variance_shares[:20]:
            lines.append(
                f"{name:<{width}}  {derivative + 0.0:>12.5g}  "  # no negative zero
                f"{abs(100 * first_order):>9.2f} %  "
                f"{100 * sampled:>7.2f} %"
            )
        if len(self.variance_shares) > 20:
            lines.append(f"... {len(self.variance_shares) - 20} more")
        lines.append(
            f"{'nonlinear':<{width}}  {'':>12}  {'':>11}  "
            f"{100 * self.nonlinear_share:>7.2f} %"
        )
        return "\n".join(lines)


@announced("tolerances")
def tolerances(
    study: Callable[[Any], Any],
    design: Any,
    output: str = "output",
    *,
    count: int = 8192,
    method: Method = "sobol",
    seed: int = 0,
    correlation: ArrayOfNumbers | None = None,
    **sweep_options: Any,
) -> Tolerances:
    """Propagate the uncertainty of parameters to an output of a study.

    Two methods are compared: the first-order formula with the exact derivatives at the
    means, and a sweep over sampled designs.

    Args:
        study: Function of one design, as for `sweep`.
        design: One design as the study takes it, with a `Normal` or a `Uniform` in place
            of each uncertain parameter.
        output: Name of the output, which must be a scalar. If the study returns a bare
            scalar, its name is "output".
        count: Number of sampled designs; powers of two are best.
        method: Sampling method; see `sample_designs`. With "sobol" or "latin_hypercube"
            and at least 128 designs, the standard errors come from the differences of
            eight independent samples. Fewer designs are one sample, whose standard
            errors are those of independent designs, which are too large. With fewer than
            16, the standard error of the standard deviation is that of a normal
            distribution.
        seed: Seed of the random number generator.
        correlation: Correlation matrix of all random variables; see `sample_designs`.
        sweep_options: Further arguments of `sweep`, such as `units`, `store` or
            `progress`.

    Returns:
        The distribution of the output.

    Raises:
        ImportError: xarray is not installed, or a store is used and zarr is not
            installed.
        ValueError: Double precision is off; no parameter has a distribution; the study
            does not return a scalar of this name; the design at the means fails; fewer
            than two sampled designs succeed; or `sweep` rejects an argument.

    Source:
        JCGM 100:2008, Guide to the expression of uncertainty in measurement, section 5,
        for the first-order formula; JCGM 101:2008, its supplement 1, for sampling.

    Example:
        >>> import twistorjax as tj
        >>> def area(design):
        ...     return design["width"] * design["height"]
        >>> rectangle = {
        ...     "width": tj.sweeps.Normal(mean=2.0, standard_deviation=0.01),
        ...     "height": tj.sweeps.Normal(mean=1.0, standard_deviation=0.01),
        ... }
        >>> result = tj.sweeps.tolerances(area, rectangle)
        >>> round(result.first_order_standard_deviation, 5)
        0.02236
        >>> [share.name for share in result.variance_shares]
        ['height', 'width']
    """
    require_packages(sweep_options.get("store"))
    require_float64(jnp.zeros(()))
    distributions = DistributionSet(design, correlation)
    if not isinstance(count, int | np.integer) or count < 2:
        raise ValueError(f"`count` is {count!r}, but must be an integer of at least 2.")
    require_memory(count, 8 * count * len(distributions.variable_names))
    replicates = _REPLICATES if method != "random" and count >= 16 * _REPLICATES else 1
    sizes = [count // replicates + (k < count % replicates) for k in range(replicates)]
    seeds = [seed]
    if replicates > 1:
        seeds = np.random.SeedSequence(seed).generate_state(replicates)
    samples = np.concatenate(
        [
            distributions.sample(size, method, int(replicate_seed))
            for size, replicate_seed in zip(sizes, seeds, strict=True)
        ]
    )

    # The first design has the means as parameters, so that one program serves for both
    # methods.
    samples_and_means = np.concatenate([distributions.means[None], samples])
    layout = distributions.layout
    parameters = zip(layout.names, layout.split(samples_and_means), strict=True)
    try:
        with warnings.catch_warnings():
            # A warning without the first design follows below.
            warnings.filterwarnings("ignore", ".* designs failed")
            everything = sweep(
                _SampledStudy(study, layout),
                dict(parameters),
                derivatives=(output,),
                **sweep_options,
            )
    except ValueError as error:
        message = str(error).replace("`derivatives` names", "`output` is")
        raise ValueError(message) from error
    if everything[output].ndim != 1:
        raise ValueError(
            f"{quote(output)} has shape {everything[output].shape[1:]} for each design, "
            "but must be a scalar."
        )
    if np.iscomplexobj(everything[output]):
        raise ValueError(
            f"{quote(output)} is complex, but must be real. Return its magnitude, "
            "`jnp.abs(...)`, or its real part."
        )
    nominal, table = everything.isel(design=0), everything.isel(design=slice(1, None))
    if not bool(nominal["succeeded"]):
        raise ValueError("The study fails for the design at the means of the parameters.")
    warn_of_failures(table)

    standard_deviations = distributions.standard_deviations
    derivatives = np.concatenate(
        [np.ravel(nominal[f"{output}_by_{p}"]) for p in layout.names]
    )
    effects = derivatives * standard_deviations
    variances = effects * (distributions.correlation @ effects)
    variance = float(variances.sum())
    succeeded = np.asarray(table["succeeded"])
    values = np.asarray(table[output])[succeeded]
    if len(values) < 2:
        raise ValueError(
            f"Only {len(values)} of {count:,} sampled designs succeed, but at least two "
            "are needed."
        )
    standard_deviation = float(values.std(ddof=1))
    sampled_shares = _sampled_shares(samples[succeeded], values, standard_deviations)
    shares = [
        VarianceShare(name, float(derivative), float(first_order), float(sampled))
        for name, derivative, first_order, sampled in zip(
            distributions.variable_names,
            derivatives,
            variances / (variance or 1.0),
            sampled_shares,
            strict=True,
        )
    ]
    replicate_values = np.split(np.asarray(table[output]), np.cumsum(sizes)[:-1])
    mean_standard_error, standard_deviation_standard_error = _standard_errors(
        [replicate[np.isfinite(replicate)] for replicate in replicate_values]
    )
    low, high = np.quantile(values, 0.025), np.quantile(values, 0.975)
    nonlinear_share = max(0.0, 1 - sampled_shares.sum()) if standard_deviation else 0.0
    return Tolerances(
        output=output,
        unit=table[output].attrs.get("units", ""),
        nominal=float(nominal[output]),
        first_order_standard_deviation=float(np.sqrt(variance)),
        mean=float(values.mean()),
        mean_standard_error=mean_standard_error,
        standard_deviation=standard_deviation,
        standard_deviation_standard_error=standard_deviation_standard_error,
        percentile_interval=(float(low), float(high)),
        variance_shares=tuple(sorted(shares, key=lambda share: -abs(share.first_order))),
        nonlinear_share=float(nonlinear_share),
        failed_count=int(np.sum(~succeeded)),
        table=table,
    )


class _SampledStudy:
    """A study as a function of its uncertain parameters."""

    def __init__(self, study: Callable[[Any], Any], layout: VectorLayout):
        self._study, self._layout = without_jit(study), layout
        self.__qualname__ = getattr(study, "__qualname__", type(study).__qualname__)

    def __call__(self, parameters: Mapping[str, Array]) -> Any:
        leaves = [parameters[name] for name in self._layout.names]
        return self._study(self._layout.design(leaves))


def _sampled_shares(
    samples: Float[np.ndarray, "designs variables"],
    values: Float[np.ndarray, " designs"],
    standard_deviations: Float[np.ndarray, " variables"],
) -> Float[np.ndarray, " variables"]:
    """Compute the shares of the random variables in the variance of an output.

    They follow from a linear least-squares fit of the output; their sum is its
    coefficient of determination.
    """
    # Scaled variables, because `lstsq` would drop a variable whose unit makes it small.
    scales = np.where(standard_deviations > 0, standard_deviations, 1.0)
    deviations = (samples - samples.mean(axis=0)) / scales
    value_deviations = values - values.mean()
    slopes = np.linalg.lstsq(deviations, value_deviations, rcond=None)[0]
    total = value_deviations @ value_deviations
    return slopes * (deviations.T @ value_deviations) / (total or 1.0)


def _standard_errors(replicates: list[np.ndarray]) -> tuple[float, float]:
    """Compute the standard errors of the mean and of the standard deviation.

    Each replicate holds the outputs of one independent sample. The designs of a single
    sample are taken as independent. A few of them do not show the fourth moment of their
    distribution, which is then that of a normal distribution.

    Source:
        Kenney and Keeping, Mathematics of Statistics, part 2, 1951, section 7.7, for the
        variance of a sampled variance.
    """
    statistics = np.array([(v.mean(), v.std(ddof=1)) for v in replicates if len(v) > 1])
    if len(statistics) > 1:
        mean, deviation = statistics.std(axis=0, ddof=1) / np.sqrt(len(statistics))
        return float(mean), float(deviation)
    values = np.concatenate(replicates)
    count, deviation = len(values), values.std(ddof=1)
    fourth_moment = 3 * deviation**4
    if count >= _FEWEST_FOR_FOURTH_MOMENT:
        fourth_moment = np.mean((values - values.mean()) ** 4)
    variance = fourth_moment / count - (count - 3) / (count - 1) * deviation**4 / count
    error = np.sqrt(max(variance, 0.0)) / (2 * deviation or 1.0)
    return float(deviation / np.sqrt(count)), float(error)
