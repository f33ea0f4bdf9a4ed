"""Designs that are sampled from the distributions of their parameters."""

from typing import Any, get_args, Literal

import numpy as np
from jaxtyping import Float

from .._utils.memory import require_memory
from .._utils.types import ArrayOfNumbers
from .._utils.validation import quote, require_choice
from .distributions import AbstractDistribution, Uniform
from .vector_layout import VectorLayout


# Probabilities keep this distance from 0 and 1, where a normal quantile is infinite.
_SMALLEST_PROBABILITY = 2.0**-53
Method = Literal["sobol", "latin_hypercube", "random"]


class DistributionSet:
    """Joint distribution of the uncertain parameters of a design.

    An uncertain parameter is a `Normal` or a `Uniform` in the design; each of its entries
    is one random variable. `correlation` is that of the standard normal variables of the
    Gaussian copula, in the order of `variable_names`; by default the random variables are
    independent.
    """

    def __init__(self, design: Any, correlation: ArrayOfNumbers | None = None):
        self.layout, self._distributions = VectorLayout.of(
            design, _is_distribution, lambda leaf: leaf.mean.shape
        )
        self.variable_names = self.layout.entry_names
        if not self.variable_names:
            raise ValueError(
                "`design` has no uncertain parameter. Use a `Normal` or a `Uniform` for "
                "at least one parameter."
            )
        self._normal_correlation = np.eye(len(self.variable_names))
        if correlation is not None:
            matrix = np.asarray(correlation, float)
            self._normal_correlation = self._checked_correlation(matrix)

    def _checked_correlation(self, matrix: np.ndarray) -> np.ndarray:
        size = len(self.variable_names)
        has_ones = matrix.shape == (size, size) and np.allclose(np.diagonal(matrix), 1)
        if not has_ones or not np.allclose(matrix, matrix.T):
            raise ValueError(
                f"`correlation` has shape {matrix.shape}, but must be a symmetric matrix "
                f"with ones on its diagonal for {', '.join(self.variable_names)}."
            )
        if np.linalg.eigvalsh(matrix)[0] < -1e-9:
            raise ValueError(
                "`correlation` has a negative eigenvalue, but a correlation matrix has "
                "none."
            )
        return matrix

    @property
    def correlation(self) -> Float[np.ndarray, "variables variables"]:
        """Correlation matrix of the random variables.

        It differs from that of the Gaussian copula for uniform variables. Let z and w be
        standard normal variables with the correlation r, and let P be their cumulative
        distribution function. The correlation of P(z) and P(w) is 6/pi asin(r/2), and
        that of P(z) and w is r sqrt(3/pi). Variables of other distributions are treated
        like normal ones, which is an approximation.
        """
        uniform = np.concatenate(
            [
                np.full(distribution.mean.size, isinstance(distribution, Uniform))
                for distribution in self._distributions
            ]
        )
        both, one = uniform[:, None] & uniform[None], uniform[:, None] ^ uniform[None]
        normal = self._normal_correlation
        mixed = np.where(one, normal * np.sqrt(3 / np.pi), normal)
        matrix = np.where(both, 6 / np.pi * np.arcsin(np.clip(normal, -1, 1) / 2), mixed)
        np.fill_diagonal(matrix, 1.0)
        return matrix

    @property
    def means(self) -> Float[np.ndarray, " variables"]:
        return np.concatenate([np.ravel(d.mean) for d in self._distributions])

    @property
    def standard_deviations(self) -> Float[np.ndarray, " variables"]:
        return np.concatenate(
            [np.ravel(d.standard_deviation) for d in self._distributions]
        )

    def sample(
        self, count: int, method: Method, seed: int
    ) -> Float[np.ndarray, "designs variables"]:
        require_choice("`method`", method, get_args(Method))
        if not isinstance(count, int | np.integer) or count < 1:
            raise ValueError(
                f"`count` is {quote(count)}, but must be an integer of at least 1."
            )
        size = len(self.variable_names)
        require_memory(count, 8 * count * size)
        from scipy.special import ndtr, ndtri
        from scipy.stats import qmc

        if method == "sobol":
            points = qmc.Sobol(size, rng=seed).random_base2(
                max(0, count - 1).bit_length()
            )
            # SciPy returns the lower ends of intervals of length 2**-30: use the centers.
            probabilities = points[:count] + 2.0**-31
        elif method == "latin_hypercube":
            probabilities = qmc.LatinHypercube(size, rng=seed).random(count)
        else:
            probabilities = np.random.default_rng(seed).random((count, size))
        probabilities = _clip_probabilities(probabilities)
        if not np.array_equal(self._normal_correlation, np.eye(size)):
            # A correlation matrix may be singular, and then has no Cholesky factor.
            eigenvalues, eigenvectors = np.linalg.eigh(self._normal_correlation)
            root = eigenvectors * np.sqrt(np.maximum(eigenvalues, 0.0))
            probabilities = _clip_probabilities(ndtr(ndtri(probabilities) @ root.T))
        values = [
            distribution.quantile(probability)
            for distribution, probability in zip(
                self._distributions, self.layout.split(probabilities), strict=True
            )
        ]
        return np.concatenate([value.reshape(count, -1) for value in values], axis=1)


def sample_designs(
    design: Any,
    count: int,
    *,
    method: Method = "sobol",
    seed: int = 0,
    correlation: ArrayOfNumbers | None = None,
) -> Any:
    """Sample designs from the distributions of their parameters.

    Args:
        design: One design as the study takes it, with a `Normal` or a `Uniform` in place
            of each uncertain parameter. The other parameters are constant.
        count: Number of designs.
        method: Sampling method. "sobol" (scrambled Sobol points, for which powers of two
            are best) and "latin_hypercube" fill the space evenly, so that means need
            fewer designs; "random" samples each design independently.
        seed: Seed of the random number generator.
        correlation: Correlation matrix of all random variables, which are the entries of
            the uncertain parameters in the order of the pytree (mappings are sorted by
            name); by default they are independent. For uniform variables it is that of
            the underlying normal variables of a Gaussian copula.

    Returns:
        The same pytree, with one entry for each design along the first axis of each
        array. It can be passed to `sweep`.

    Raises:
        ValueError: No parameter has a distribution, `count` is not a positive integer,
            the method is unknown, `correlation` is not a correlation matrix, or the
            samples do not fit into the memory of the machine.

    Source:
        Sobol, USSR Comput. Math. Math. Phys. 7, 1967; McKay, Beckman and Conover,
        Technometrics 21, 1979.

    Example:
        >>> from twistorjax.sweeps import Normal
        >>> web = Normal(mean=250e-6, standard_deviation=10e-6)
        >>> designs = sample_designs({"web": web, "travel": 1e-6}, count=1024)
        >>> designs["web"].shape, designs["travel"].shape
        ((1024,), (1024,))
        >>> round(float(designs["web"].mean()), 9)
        0.00025
    """
    distributions = DistributionSet(design, correlation)
    return distributions.layout.designs(distributions.sample(count, method, seed))


def _is_distribution(leaf: Any) -> bool:
    return isinstance(leaf, AbstractDistribution)


def _clip_probabilities(probabilities: np.ndarray) -> np.ndarray:
    """Move probabilities away from 0 and 1, so that all quantiles are finite."""
    return np.clip(probabilities, _SMALLEST_PROBABILITY, 1 - _SMALLEST_PROBABILITY)
