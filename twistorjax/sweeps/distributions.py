"""What is not known exactly: how parameters spread, and designs drawn from them."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, get_args, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.pytrees import entry_names, path_name
from .._utils.validation import concrete, require_choice
from .memory import need_memory


_RARE = 2.0**-53
Method = Literal["sobol", "latin", "random"]


class AbstractDistribution(eqx.Module):
    """How a parameter, or each of several, is distributed.

    Args:
        mean: of it.
        deviation: its standard deviation.
    """

    mean: eqx.AbstractVar[Float[Array, "..."]]
    deviation: eqx.AbstractVar[Float[Array, "..."]]

    @abstractmethod
    def quantile(self, part: Float[np.ndarray, "*designs"]) -> Float[np.ndarray, "..."]:
        """What is not exceeded by that part of all, between 0 and 1."""


class Normal(AbstractDistribution):
    """A parameter that is normally distributed; or several, each for itself.

    Args:
        mean: of it.
        deviation: standard deviation.

    Raises:
        ValueError: a deviation is negative, a number not finite, or their shapes differ.

    Example:
        >>> Normal(250e-6, 10e-6)
        Normal(mean=0.00025, deviation=1e-05)
    """

    mean: Float[Array, "..."]
    deviation: Float[Array, "..."]

    def __init__(
        self,
        mean: ArrayLike | Sequence[ArrayLike],
        deviation: ArrayLike | Sequence[ArrayLike],
    ):
        self.mean, self.deviation = _together("mean", mean, "deviation", deviation)
        sizes = concrete(self.deviation)
        if sizes is not None and np.any(sizes < 0):
            raise ValueError(f"`deviation` is {deviation}, but must not be negative.")

    def quantile(self, part: Float[np.ndarray, "*designs"]) -> Float[np.ndarray, "..."]:
        from scipy.special import ndtri

        return np.asarray(self.mean) + np.asarray(self.deviation) * ndtri(part)

    def __repr__(self) -> str:
        return _told(self, mean=self.mean, deviation=self.deviation)


class Uniform(AbstractDistribution):
    """A parameter that is as likely anywhere between two bounds; or several.

    Args:
        low: the lower bound.
        high: the upper one.

    Raises:
        ValueError: a bound is not finite, the lower is above the upper, or their shapes
            differ.

    Example:
        >>> Uniform(0.2e-3, 0.3e-3)
        Uniform(low=0.0002, high=0.0003)
    """

    low: Float[Array, "..."]
    high: Float[Array, "..."]

    def __init__(
        self,
        low: ArrayLike | Sequence[ArrayLike],
        high: ArrayLike | Sequence[ArrayLike],
    ):
        self.low, self.high = _together("low", low, "high", high)
        seen = concrete(self.high - self.low)
        if seen is not None and np.any(seen < 0):
            raise ValueError(f"`low` is {low} and `high` {high}, but low is the lower.")

    @property
    def mean(self) -> Float[Array, "..."]:
        """Half way."""
        return (self.low + self.high) / 2

    @property
    def deviation(self) -> Float[Array, "..."]:
        """The range by the root of twelve."""
        return (self.high - self.low) / np.sqrt(12)

    def quantile(self, part: Float[np.ndarray, "*designs"]) -> Float[np.ndarray, "..."]:
        return np.asarray(self.low) + np.asarray(self.high - self.low) * part

    def __repr__(self) -> str:
        return _told(self, low=self.low, high=self.high)


class DistributionSet:
    """The parameters of a design that spread, among those that are known.

    Args:
        designs: what the study takes, a tree, with a `Normal` or a `Uniform` for each
            parameter that is not known exactly.
        correlation: of all numbers that spread, in the order of `names`; by default they
            are independent. Of uniform ones, that of the normal numbers they are made
            of: the property of the same name is that of the numbers themselves.

    Raises:
        ValueError: nothing spreads; the correlation is no matrix of that kind.
    """

    def __init__(self, designs: Any, correlation: ArrayLike | None = None):
        paths, self._tree = jax.tree_util.tree_flatten_with_path(
            designs, is_leaf=_is_spread
        )
        self._leaves = [leaf for _, leaf in paths]
        self._spread = {path_name(path): leaf for path, leaf in paths if _is_spread(leaf)}
        self.spreads: list[AbstractDistribution] = list(self._spread.values())
        names: list[str] = []
        for name, spread in self._spread.items():
            names += entry_names(name, spread.mean.shape)
        self.names = tuple(names)
        if not names:
            raise ValueError(
                "Nothing spreads: give a `Normal` or a `Uniform` for at least one "
                "parameter."
            )
        self._underlying = np.eye(len(names))
        if correlation is not None:
            self._underlying = self._checked(np.asarray(correlation, float))

    def _checked(self, matrix: np.ndarray) -> np.ndarray:
        count = len(self.names)
        ones = matrix.shape == (count, count) and np.allclose(np.diagonal(matrix), 1)
        if not ones or not np.allclose(matrix, matrix.T):
            raise ValueError(
                f"`correlation` has shape {matrix.shape}, but must be a symmetric matrix "
                f"with ones on its diagonal for {', '.join(self.names)}."
            )
        if np.linalg.eigvalsh(matrix)[0] < -1e-9:
            raise ValueError(
                "`correlation` has a negative eigenvalue: no numbers are correlated so."
            )
        return matrix

    @property
    def correlation(self) -> Float[np.ndarray, "numbers numbers"]:
        """Of the numbers that spread.

        Where normal numbers z, w are correlated by r, their parts P(z), P(w) between 0
        and 1 are by 6/pi asin(r/2), and P(z) and w by r sqrt(3/pi).
        """
        even = np.concatenate(
            [np.full(s.mean.size, isinstance(s, Uniform)) for s in self.spreads]
        )
        both, one = even[:, None] & even[None], even[:, None] ^ even[None]
        made = self._underlying
        mixed = np.where(one, made * np.sqrt(3 / np.pi), made)
        found = np.where(both, 6 / np.pi * np.arcsin(np.clip(made, -1, 1) / 2), mixed)
        np.fill_diagonal(found, 1.0)
        return found

    @property
    def known(self) -> tuple[Any, ...]:
        """What tells one kind of design from another: all but the numbers that spread."""
        told = [
            leaf.mean.shape
            if _is_spread(leaf)
            else (np.shape(leaf), np.asarray(leaf).dtype.str, np.asarray(leaf).tobytes())
            for leaf in self._leaves
        ]
        return self._tree, *told

    @property
    def _cuts(self) -> np.ndarray:
        """Where in a row of all numbers those of the next parameter begin."""
        return np.cumsum([spread.mean.size for spread in self.spreads])[:-1]

    @property
    def means(self) -> Float[np.ndarray, " numbers"]:
        """Of all that spread."""
        return np.concatenate([np.ravel(spread.mean) for spread in self.spreads])

    @property
    def deviations(self) -> Float[np.ndarray, " numbers"]:
        """Of all that spread."""
        return np.concatenate([np.ravel(spread.deviation) for spread in self.spreads])

    def rows(self, drawn: Float[np.ndarray, "count numbers"]) -> Any:
        """Designs, an entry for each along the first axis of every array."""
        parts = iter(self.columns(drawn).values())
        leaves = [
            next(parts)
            if _is_spread(leaf)
            else np.broadcast_to(leaf, (len(drawn), *np.shape(leaf)))
            for leaf in self._leaves
        ]
        return jax.tree.unflatten(self._tree, leaves)

    def columns(
        self, drawn: Float[np.ndarray, "count numbers"]
    ) -> dict[str, Float[np.ndarray, "count ..."]]:
        """The parameters that spread, by name, an entry for each design."""
        parts = np.split(drawn, self._cuts, axis=1)
        return {
            name: part.reshape(len(drawn), *spread.mean.shape)
            for (name, spread), part in zip(self._spread.items(), parts, strict=True)
        }

    def design(self, columns: Mapping[str, Array]) -> Any:
        """The design with such parameters for those that spread."""
        parts = iter(columns[name] for name in self._spread)
        leaves = [next(parts) if _is_spread(leaf) else leaf for leaf in self._leaves]
        return jax.tree.unflatten(self._tree, leaves)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of those that spread."""
        return tuple(self._spread)

    def drawn(
        self, count: int, method: Method, key: int
    ) -> Float[np.ndarray, "count numbers"]:
        """So many designs, of each the numbers that spread."""
        require_choice("`method`", method, get_args(Method))
        if not isinstance(count, int | np.integer) or count < 1:
            raise ValueError(f"`count` is {count!r}, but must be a whole number from 1.")
        need_memory(count, 8 * count * len(self.names))
        from scipy.special import ndtr, ndtri
        from scipy.stats import qmc

        size = len(self.names)
        if method == "sobol":
            whole = qmc.Sobol(size, rng=key).random_base2(max(0, count - 1).bit_length())
            parts = whole[:count] + 2.0**-31  # the middle of its steps
        elif method == "latin":
            parts = qmc.LatinHypercube(size, rng=key).random(count)
        else:
            parts = np.random.default_rng(key).random((count, size))
        # no number is infinitely far off
        parts = np.clip(parts, _RARE, 1 - _RARE)
        if not np.array_equal(self._underlying, np.eye(size)):
            # of a matrix that may be singular, where Cholesky's factor is not to be had
            sizes, directions = np.linalg.eigh(self._underlying)
            root = directions * np.sqrt(np.maximum(sizes, 0.0))
            parts = np.clip(ndtr(ndtri(parts) @ root.T), _RARE, 1 - _RARE)
        columns = [
            spread.quantile(part.reshape(count, *spread.mean.shape)).reshape(count, -1)
            for spread, part in zip(
                self.spreads, np.split(parts, self._cuts, axis=1), strict=True
            )
        ]
        return np.concatenate(columns, axis=1)


def sample_designs(
    designs: Any,
    count: int,
    *,
    method: Method = "sobol",
    key: int = 0,
    correlation: ArrayLike | None = None,
) -> Any:
    """Designs drawn from how their parameters spread, for `sweep`.

    Args:
        designs: what the study takes, a tree, with a `Normal` or a `Uniform` for each
            parameter that is not known exactly; the others are the same for all.
        count: how many.
        method: "sobol", of which powers of two are best, and "latin" fill the space
            evenly, so that means need fewer designs; "random" draws each for itself.
        key: a whole number; another one draws others.
        correlation: of all numbers that spread, in their order in the tree (mappings
            by the order of their names); by default they are independent. Of uniform
            ones, that of the normal numbers they are made of.

    Returns:
        The same tree, with an entry for each design along the first axis of each array.

    Raises:
        ValueError: nothing spreads, there is no design, the method is unknown, or the
            correlation is none.

    Source:
        Sobol, USSR Comput. Math. Math. Phys. 7, 1967; McKay, Beckman and Conover,
        Technometrics 21, 1979.

    Example:
        >>> webs = sample_designs({"web": Normal(250e-6, 10e-6), "travel": 1e-6}, 1024)
        >>> webs["web"].shape, round(float(webs["web"].mean()), 9), webs["travel"].shape
        ((1024,), 0.00025, (1024,))
    """
    spreads = DistributionSet(designs, correlation)
    return spreads.rows(spreads.drawn(count, method, key))


def _is_spread(leaf: Any) -> bool:
    return isinstance(leaf, AbstractDistribution)


def _together(
    first: str,
    one: ArrayLike | Sequence[ArrayLike],
    second: str,
    other: ArrayLike | Sequence[ArrayLike],
) -> tuple[Array, Array]:
    """Two arrays of one shape, finite as far as can be seen."""
    arrays = jnp.asarray(one, float), jnp.asarray(other, float)
    try:
        arrays = jnp.broadcast_arrays(*arrays)
    except ValueError:
        raise ValueError(
            f"`{first}` has shape {arrays[0].shape} and `{second}` {arrays[1].shape}, "
            "but they must be of one shape."
        ) from None
    for name, array in zip((first, second), arrays, strict=True):
        seen = concrete(array)
        if seen is not None and not np.all(np.isfinite(seen)):
            raise ValueError(f"`{name}` is {seen.tolist()}, but must be finite.")
    return arrays[0], arrays[1]


def _told(spread: AbstractDistribution, **numbers: Array) -> str:
    parts = []
    for name, array in numbers.items():
        seen = concrete(array)
        if seen is None:
            return eqx.tree_pformat(spread)
        parts.append(f"{name}={np.array2string(seen, precision=6)}")
    return f"{type(spread).__name__}({', '.join(parts)})"
