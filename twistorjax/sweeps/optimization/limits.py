"""Limits of the outputs of a study."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..._utils.types import NumbersLike


class Limit(eqx.Module):
    """Smallest and largest allowed value of an output of a study.

    Args:
        lower: Smallest allowed value, or one for each entry of the output; in its unit.
        upper: Largest allowed value, or one for each entry. If it is equal to the
            smallest one, the output is prescribed.

    Raises:
        ValueError: There is neither a lower nor an upper limit, a limit is not a number,
            or the lower limit exceeds the upper one.

    Example:
        >>> Limit(upper=85e6)
        Limit(upper=8.5e+07)
    """

    lower: Float[np.ndarray, "..."] | None
    upper: Float[np.ndarray, "..."] | None

    def __init__(
        self, lower: NumbersLike | None = None, upper: NumbersLike | None = None
    ):
        self.lower = None if lower is None else np.asarray(lower, float)
        self.upper = None if upper is None else np.asarray(upper, float)
        if self.lower is None and self.upper is None:
            raise ValueError("A `Limit` is empty. Give `lower`, `upper`, or both.")
        for name, bound in (("lower", self.lower), ("upper", self.upper)):
            if bound is not None and not np.all(np.isfinite(bound)):
                raise ValueError(
                    f"`{name}` of a `Limit` is {bound.tolist()}, but must be finite. "
                    "Leave out a side that is not limited."
                )
        if self.lower is not None and self.upper is not None:
            try:
                ordered = np.all(self.lower <= self.upper)
            except ValueError:
                raise ValueError(
                    f"`lower` of a `Limit` has shape {self.lower.shape} and `upper` "
                    f"{self.upper.shape}. Give numbers, or arrays of the same shape."
                ) from None
            if not ordered:
                raise ValueError(
                    f"`lower` of a `Limit` is {self.lower.tolist()} and `upper` is "
                    f"{self.upper.tolist()}, but `lower` must not exceed `upper`."
                )

    @property
    def sides(self) -> tuple[Float[np.ndarray, "..."] | None, ...]:
        """The lower and the upper limit."""
        return self.lower, self.upper

    def __repr__(self) -> str:
        sides: dict[str, Any] = {"lower": self.lower, "upper": self.upper}
        texts = [
            f"{name}={bound:.6g}" if not bound.ndim else f"{name}={bound.tolist()}"
            for name, bound in sides.items()
            if bound is not None
        ]
        return f"Limit({', '.join(texts)})"
