"""Probability distributions of uncertain parameters."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import concrete
from .._utils.types import Numbers, NumbersLike


class AbstractDistribution(eqx.Module):
    """Probability distribution of a parameter.

    If the parameter is an array, its entries are independent random variables.

    Args:
        mean: Mean of each entry of the parameter.
        standard_deviation: Standard deviation of each entry.
    """

    mean: eqx.AbstractVar[Numbers]
    standard_deviation: eqx.AbstractVar[Numbers]

    @abstractmethod
    def quantile(
        self, probability: Float[np.ndarray, "*designs"]
    ) -> Float[np.ndarray, "..."]:
        """Compute the value that is not exceeded with a given probability.

        Args:
            probability: Probabilities between 0 and 1; the last axes are those of the
                parameter.

        Returns:
            The quantiles, in the shape of `probability`.
        """


class Normal(AbstractDistribution):
    """Normal distribution of a parameter.

    Args:
        mean: Mean of each entry of the parameter.
        standard_deviation: Standard deviation of each entry, in the unit of the mean.

    Raises:
        ValueError: A standard deviation is negative, a number is not finite, or the
            shapes differ.

    Example:
        >>> Normal(mean=250e-6, standard_deviation=10e-6)
        Normal(mean=0.00025, standard_deviation=1e-05)
    """

    mean: Numbers
    standard_deviation: Numbers

    def __init__(self, mean: NumbersLike, standard_deviation: NumbersLike):
        self.mean, self.standard_deviation = _broadcast(
            "mean", mean, "standard_deviation", standard_deviation
        )
        value = concrete(self.standard_deviation)
        if value is not None and np.any(value < 0):
            raise ValueError(
                f"`standard_deviation` is {standard_deviation}, but must not be negative."
            )

    def quantile(
        self, probability: Float[np.ndarray, "*designs"]
    ) -> Float[np.ndarray, "..."]:
        from scipy.special import ndtri

        standard_deviation = np.asarray(self.standard_deviation)
        return np.asarray(self.mean) + standard_deviation * ndtri(probability)

    def __repr__(self) -> str:
        return _format(self, mean=self.mean, standard_deviation=self.standard_deviation)


class Uniform(AbstractDistribution):
    """Uniform distribution of a parameter between two bounds.

    Args:
        low: Lower bound of each entry of the parameter.
        high: Upper bound of each entry, in the same unit.

    Raises:
        ValueError: A bound is not finite, a lower bound exceeds the upper bound, or the
            shapes differ.

    Example:
        >>> Uniform(low=0.2e-3, high=0.3e-3)
        Uniform(low=0.0002, high=0.0003)
    """

    low: Numbers
    high: Numbers

    def __init__(self, low: NumbersLike, high: NumbersLike):
        self.low, self.high = _broadcast("low", low, "high", high)
        width = concrete(self.high - self.low)
        if width is not None and np.any(width < 0):
            raise ValueError(
                f"`low` is {low} and `high` is {high}, but `low` must not exceed `high`."
            )

    @property
    def mean(self) -> Numbers:
        """Mean of the two bounds."""
        return (self.low + self.high) / 2

    @property
    def standard_deviation(self) -> Numbers:
        """Standard deviation, which is the width divided by the square root of 12."""
        return (self.high - self.low) / np.sqrt(12)

    def quantile(
        self, probability: Float[np.ndarray, "*designs"]
    ) -> Float[np.ndarray, "..."]:
        return np.asarray(self.low) + np.asarray(self.high - self.low) * probability

    def __repr__(self) -> str:
        return _format(self, low=self.low, high=self.high)


def _broadcast(
    first_name: str, first: NumbersLike, second_name: str, second: NumbersLike
) -> tuple[Array, Array]:
    """Broadcast two arguments to one shape, and check that concrete values are finite."""
    arrays = jnp.asarray(first, float), jnp.asarray(second, float)
    try:
        arrays = jnp.broadcast_arrays(*arrays)
    except ValueError:
        raise ValueError(
            f"`{first_name}` has shape {arrays[0].shape} and `{second_name}` "
            f"{arrays[1].shape}, but both must have the same shape."
        ) from None
    for name, array in zip((first_name, second_name), arrays, strict=True):
        value = concrete(array)
        if value is not None and not np.all(np.isfinite(value)):
            raise ValueError(f"`{name}` is {value.tolist()}, but must be finite.")
    return arrays[0], arrays[1]


def _format(distribution: AbstractDistribution, **parameters: Array) -> str:
    """Format a distribution with its parameters, or their shapes while JAX traces it."""
    parts = []
    for name, array in parameters.items():
        value = concrete(array)
        if value is None:
            return eqx.tree_pformat(distribution)
        parts.append(f"{name}={np.array2string(value, precision=6)}")
    return f"{type(distribution).__name__}({', '.join(parts)})"
