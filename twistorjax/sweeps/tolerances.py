"""What tolerances of the parameters make of an answer."""

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..solve.tables import require_xarray
from .distributions import DistributionSet, Method
from .memory import need_memory
from .sweep import sweep, warn_of_failures


if TYPE_CHECKING:
    import xarray


_GROUPS = 8  # samples, each for itself


class VarianceShare(NamedTuple):
    """How much of the spread of an answer one parameter brings.

    Of correlated parameters each has what it brings together with the others, which may
    be negative, or more than the whole; those that are but one are given equal parts.

    Args:
        name: of the parameter.
        slope: of the answer by it, at the means.
        first_order: its part of the variance, by the slopes.
        sample_designs: its part of the variance of the designs that were drawn, by the linear
            function of the parameters that fits them best.
    """

    name: str
    slope: float
    first_order: float
    sampled: float


class Tolerances(NamedTuple):
    """How an answer spreads as its parameters do, found in two ways.

    Args:
        answer: its name.
        unit: of it.
        nominal: the answer at the means of the parameters.
        deviation: its standard deviation to first order, by the exact slopes.
        mean: of the designs that were drawn.
        mean_error: standard error of that.
        spread: standard deviation of the designs that were drawn.
        spread_error: standard error of that.
        interval: in which 95 % of them lie.
        shares: what each parameter brings, the largest first.
        nonlinear: the part of the variance of the designs that were drawn that no linear
            function of the parameters brings.
        failed: how many of them have no answer; they take no part.
        table: all of them, as `sweep` tells.
    """

    answer: str
    unit: str
    nominal: float
    deviation: float
    mean: float
    mean_error: float
    spread: float
    spread_error: float
    interval: tuple[float, float]
    shares: tuple[VarianceShare, ...]
    nonlinear: float
    failed: int
    table: "xarray.Dataset"

    @property
    def disagreement(self) -> float:
        """Of the two standard deviations, relative to the one of the drawn designs.

        What of it is beyond `spread_error / spread` shows that the answer is not linear
        over the tolerances.
        """
        return self.deviation / self.spread - 1 if self.spread else 0.0

    @property
    def shift(self) -> float:
        """Of the mean from the nominal answer, which no linear map would show."""
        return self.mean - self.nominal

    def __repr__(self) -> str:
        unit = "" if self.unit in ("", "1") else f" {self.unit}"

        def row(what: str, mean: float, deviation: float, digits: int) -> str:
            numbers = f"{mean:>12.{digits + 2}g}  {deviation:>12.{digits}g}"
            return f"{what:<14}  {numbers}{unit}"

        count = self.table.sizes["design"]
        low, high = self.interval
        apart = 100 * self.disagreement
        lines = [
            f"{self.answer} of {count - self.failed:,} designs",
            f"{'':<14}  {'mean':>12}  {'deviation':>12}",
            row("first order", self.nominal, self.deviation, 4),
            row("drawn", self.mean, self.spread, 4),
            row("± of drawn", self.mean_error, self.spread_error, 2),
            f"95 % between {low:.6g} and {high:.6g}{unit}; the deviations differ by "
            f"{apart:.2g} %, the means by {self.shift:.2g}{unit}",
        ]
        if self.failed:
            lines.append(f"warning: {self.failed:,} designs have no answer")
        wide = max(9, *(len(share.name) for share in self.shares))
        head = f"{'parameter':<{wide}}  {'slope':>12}  {'of variance':>11}  {'drawn':>8}"
        lines.append(head)
        for name, slope, first, drawn in self.shares[:20]:
            lines.append(
                f"{name:<{wide}}  {slope:>12.5g}  {100 * first:>9.2f} %  "
                f"{100 * drawn:>6.2f} %"
            )
        if len(self.shares) > 20:
            lines.append(f"... {len(self.shares) - 20} more")
        lines.append(
            f"{'not linear':<{wide}}  {'':>12}  {'':>11}  {100 * self.nonlinear:>6.2f} %"
        )
        return "\n".join(lines)


def tolerances(
    study: Callable[[Any], Any],
    designs: Any,
    answer: str = "answer",
    *,
    count: int = 8192,
    method: Method = "sobol",
    key: int = 0,
    correlation: ArrayLike | None = None,
    **settings: Any,
) -> Tolerances:
    """How an answer spreads with the parameters: drawn designs beside first order.

    Args:
        study: of one design, as for `sweep`.
        designs: what it takes, with a `Normal` or a `Uniform` for each parameter that is
            not known exactly.
        answer: the name of the number that is looked at; "answer" of a study that gives
            just a number.
        count: how many designs are drawn, best a power of two.
        method: how: see `sample_designs`. Of what fills the space evenly eight samples are
            drawn, each for itself, whose differences give the standard errors; fewer
            than 128 designs are one sample, whose errors are told as if each had been
            drawn for itself, which is too large.
        key: likewise.
        correlation: likewise.
        settings: more for `sweep`: `units` of parameters and answers, a `store`, a bar.

    Raises:
        ImportError: xarray is not installed.
        ValueError: double precision is off; nothing spreads; the study does not answer a
            number of that name; the design of the means, or every design, has no answer;
            or what `sweep` refuses.

    Source:
        JCGM 100:2008, Guide to the expression of uncertainty in measurement, section 5;
        its supplement 1, JCGM 101:2008, for the drawn designs.

    Example:
        >>> from twistorjax.sweeps import Normal
        >>> def area(design):
        ...     return design["width"] * design["height"]
        >>> sides = {"width": Normal(2.0, 0.01), "height": Normal(1.0, 0.01)}
        >>> seen = tolerances(area, sides)
        >>> round(seen.deviation, 5), [share.name for share in seen.shares]
        (0.02236, ['height', 'width'])
    """
    require_xarray()
    if jnp.result_type(float) != jnp.float64:
        raise ValueError(
            "Small differences need double precision, which JAX has off. Before any "
            'array is made, write `jax.config.update("jax_enable_x64", True)`.'
        )
    spreads = DistributionSet(designs, correlation)
    if not isinstance(count, int | np.integer) or count < 2:
        raise ValueError(f"`count` is {count!r}, but must be a whole number from 2.")
    need_memory(count, 8 * count * len(spreads.names))
    groups = _GROUPS if method != "random" and count >= 16 * _GROUPS else 1
    sizes = [count // groups + (k < count % groups) for k in range(groups)]
    keys = np.random.SeedSequence(key).generate_state(groups) if groups > 1 else [key]
    drawn = np.concatenate(
        [
            spreads.drawn(size, method, int(own))
            for size, own in zip(sizes, keys, strict=True)
        ]
    )

    # the means are the first design, so that one program serves for all
    rows = np.concatenate([spreads.means[None], drawn])
    one = _OfSpread(study, spreads)
    try:
        with warnings.catch_warnings():
            # told below, of those drawn
            warnings.filterwarnings("ignore", ".* designs have no answer")
            whole = sweep(one, spreads.columns(rows), derivatives=(answer,), **settings)
    except ValueError as error:
        text = str(error).replace("`derivatives` names", "`answer` is")
        raise ValueError(text) from error
    if whole[answer].ndim != 1:
        raise ValueError(
            f"{answer!r} has shape {whole[answer].shape[1:]} for each design, but must "
            "be a number."
        )
    center, table = whole.isel(design=0), whole.isel(design=slice(1, None))
    if not bool(center["succeeded"]):
        raise ValueError("The design at the means of the parameters has no answer.")
    warn_of_failures(table)
    slopes = np.concatenate(
        [np.ravel(center[f"{answer}_by_{name}"]) for name in spreads.parameters]
    )
    moved = slopes * spreads.deviations
    brought = moved * (spreads.correlation @ moved)
    variance = float(brought.sum())
    fine = np.asarray(table["succeeded"])
    values = np.asarray(table[answer])[fine]
    if len(values) < 2:
        raise ValueError(f"Only {len(values)} of {count:,} drawn designs have an answer.")
    spread = float(values.std(ddof=1))
    seen = _brought(drawn[fine], values, spreads.deviations)
    shares = [
        VarianceShare(name, float(slope), float(first), float(other))
        for name, slope, first, other in zip(
            spreads.names, slopes, brought / (variance or 1.0), seen, strict=True
        )
    ]
    samples = np.split(np.asarray(table[answer]), np.cumsum(sizes)[:-1])
    mean_error, spread_error = _errors([s[np.isfinite(s)] for s in samples])
    return Tolerances(
        answer=answer,
        unit=table[answer].attrs.get("units", ""),
        nominal=float(center[answer]),
        deviation=float(np.sqrt(variance)),
        mean=float(values.mean()),
        mean_error=mean_error,
        spread=spread,
        spread_error=spread_error,
        interval=(float(np.quantile(values, 0.025)), float(np.quantile(values, 0.975))),
        shares=tuple(sorted(shares, key=lambda share: -abs(share.first_order))),
        nonlinear=float(max(0.0, 1 - seen.sum())) if spread else 0.0,
        failed=int(np.sum(~fine)),
        table=table,
    )


class _OfSpread:
    """A study as a function of what spreads; equal if it does the same.

    So that what was compiled of it is found again.
    """

    def __init__(self, study: Callable[[Any], Any], spreads: DistributionSet):
        self._study, self._spreads = study, spreads
        self._known = (study, *spreads.known)
        self.__qualname__ = getattr(study, "__qualname__", type(study).__qualname__)

    def __call__(self, parameters: Mapping[str, Array]) -> Any:
        return self._study(self._spreads.design(parameters))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _OfSpread) and self._known == other._known

    def __hash__(self) -> int:
        return hash(self._known)


def _brought(
    drawn: Float[np.ndarray, "designs numbers"],
    values: Float[np.ndarray, " designs"],
    deviations: Float[np.ndarray, " numbers"],
) -> Float[np.ndarray, " numbers"]:
    """What each number brings of the variance, by the linear function that fits best."""
    # by their deviations, lest one that is small in its unit be taken for nothing
    apart = (drawn - drawn.mean(axis=0)) / np.where(deviations > 0, deviations, 1.0)
    moved = values - values.mean()
    slopes = np.linalg.lstsq(apart, moved, rcond=None)[0]
    whole = moved @ moved
    return slopes * (apart.T @ moved) / (whole or 1.0)


def _errors(samples: list[np.ndarray]) -> tuple[float, float]:
    """Standard errors of the mean and of the deviation: of one sample, or of several."""
    if len(samples) == 1:
        (values,) = samples
        spread = values.std(ddof=1)
        fourth = np.mean((values - values.mean()) ** 4)
        error = np.sqrt(max(fourth - spread**4, 0.0) / len(values)) / (2 * spread or 1.0)
        return float(spread / np.sqrt(len(values))), float(error)
    told = np.array([(v.mean(), v.std(ddof=1)) for v in samples if len(v) > 1])
    mean, spread = told.std(axis=0, ddof=1) / np.sqrt(len(told))
    return float(mean), float(spread)
