"""What tolerances of the parameters make of an answer."""

from collections.abc import Callable
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..solve.tables import need_xarray
from .spreads import Method, Spreads
from .sweep import sweep


if TYPE_CHECKING:
    import xarray


class Share(NamedTuple):
    """How much of the spread of an answer one parameter brings.

    Args:
        name: of the parameter.
        slope: of the answer by it, at the means.
        first_order: its part of the variance, by the slopes; of correlated parameters
            the part that its correlations bring is shared with the others.
        sampled: the same of the designs that were drawn: of the variance of the best
            linear function of the parameters. What is left of one is not linear.
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
        mean_error: standard error of that, as if each had been drawn for itself.
        spread: standard deviation of the designs that were drawn.
        spread_error: standard error of that, likewise.
        interval: in which 95 % of them lie.
        shares: what each parameter brings, the largest first.
        failed: how many of them have no answer; they take no part.
        table: all of them.
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
    shares: tuple[Share, ...]
    failed: int
    table: "xarray.Dataset"

    @property
    def disagreement(self) -> float:
        """Of the two standard deviations, relative to the one of the drawn designs.

        What of it is beyond `spread_error` shows that the answer is not linear over the
        tolerances.
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
            row("± (drawn)", self.mean_error, self.spread_error, 2),
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
        count: how many designs are drawn.
        method: how: see `sampled`.
        key: likewise.
        correlation: likewise.
        settings: more for `sweep`: units, a store, a bar.

    Raises:
        ImportError: xarray is not installed.
        ValueError: nothing spreads; the study does not answer a number of that name; the
            design of the means, or every design, has no answer; or what `sweep` refuses.

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
    need_xarray()
    spreads = Spreads(designs, correlation)
    drawn = spreads.drawn(count, method, key)

    def one(row: dict[str, Array]) -> Any:
        return study(spreads.design(row["numbers"]))

    # the means are the first design, so that one program serves for all
    rows = np.concatenate([spreads.means[None], drawn])
    whole = sweep(one, {"numbers": rows}, derivatives=(answer,), **settings)
    if whole[answer].ndim != 1:
        raise ValueError(
            f"{answer!r} has shape {whole[answer].shape[1:]} for each design, but must "
            "be a number."
        )
    whole = whole.rename(numbers_0="parameter", numbers="parameters")
    whole = whole.rename({f"{answer}_by_numbers": f"{answer}_by_parameters"})
    whole = whole.assign_coords(parameter=list(spreads.names))
    center, table = whole.isel(design=0), whole.isel(design=slice(1, None))
    if not bool(center["succeeded"]):
        raise ValueError("The design at the means of the parameters has no answer.")
    slopes = np.asarray(center[f"{answer}_by_parameters"])
    moved = slopes * spreads.deviations
    variance = float(moved @ spreads.correlation @ moved)
    fine = np.asarray(table["succeeded"])
    values = np.asarray(table[answer])[fine]
    if len(values) < 2:
        raise ValueError(f"Only {len(values)} of {count:,} drawn designs have an answer.")
    apart = drawn[fine] - drawn[fine].mean(axis=0)
    fitted = np.linalg.lstsq(apart, values - values.mean(), rcond=None)[0]
    parts = _parts(fitted * spreads.deviations, spreads.correlation)
    first = _parts(moved, spreads.correlation)
    shares = [
        Share(name, float(slope), float(one), float(other))
        for name, slope, one, other in zip(
            spreads.names, slopes, first, parts, strict=True
        )
    ]
    spread = float(values.std(ddof=1))
    fourth = float(np.mean((values - values.mean()) ** 4))
    return Tolerances(
        answer=answer,
        unit=table[answer].attrs.get("units", ""),
        nominal=float(center[answer]),
        deviation=float(np.sqrt(variance)),
        mean=float(values.mean()),
        mean_error=spread / float(np.sqrt(len(values))),
        spread=spread,
        spread_error=float(np.sqrt(max(fourth - spread**4, 0.0) / len(values)))
        / (2 * spread or 1.0),
        interval=(float(np.quantile(values, 0.025)), float(np.quantile(values, 0.975))),
        shares=tuple(sorted(shares, key=lambda share: -share.first_order)),
        failed=int(np.sum(~fine)),
        table=table,
    )


def _parts(
    moved: Float[np.ndarray, " numbers"],
    correlation: Float[np.ndarray, "numbers numbers"],
) -> Float[np.ndarray, " numbers"]:
    """What each number brings of the variance."""
    parts = moved * (correlation @ moved)
    total = parts.sum()
    return parts / total if total > 0 else np.zeros_like(parts)
