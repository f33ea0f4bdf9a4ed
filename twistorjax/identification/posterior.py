"""What measurements leave possible, by sampling."""

from typing import Any, TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._utils.validation import require_package
from .compilation import fast_compile
from .measurement import a_key
from .report import Identification


if TYPE_CHECKING:
    import arviz


def posterior(
    found: Identification,
    *,
    draws: int = 500,
    tune: int = 500,
    chains: int = 2,
    prior: float = 3.0,
    key: Array | int = 0,
) -> "arviz.InferenceData":
    """Samples of the unknowns as the measurements leave them, by Hamiltonian dynamics.

    Where a model is far from linear over its own uncertainty, standard errors mislead:
    this does not. Errors of readings are normal, with the deviations told. Before the
    measurements each unknown's relative change from its start is normal, so that one
    with a bound is log-normal about it.

    Args:
        found: a fit without a robust loss, from whose estimates the chains begin.
        draws: samples of each chain.
        tune: samples before these, by which the sampler adapts itself.
        chains: that are run side by side, to be compared.
        prior: standard deviation of the relative changes before the measurements.
        key: of random numbers, or a whole number to make it of.

    Returns:
        The draws, as arviz keeps them: `arviz.summary(draws)` tells of their quality.

    Raises:
        ImportError: blackjax or arviz is not installed.
        ValueError: the loss was robust.

    Source:
        Hoffman and Gelman, Journal of Machine Learning Research 15, 2014.
    """
    arviz, blackjax = (
        require_package(name, "Samples", "posterior") for name in ("arviz", "blackjax")
    )
    problem = found.problem
    if problem.robust is not None:
        raise ValueError(
            "A robust loss is not the logarithm of a density of errors: fit without "
            "`robust` before sampling."
        )

    @jax.custom_jvp
    def misfit(place: Array) -> Array:
        return problem.found(place).loss

    @misfit.defjvp
    def _(places: Any, moved: Any) -> tuple[Array, Array]:
        # forwards, for few unknowns
        seen = problem.found(places[0])
        return seen.loss, seen.gradient @ moved[0]

    def density(place: Array) -> Array:
        return -misfit(place) - jnp.sum((place / prior) ** 2) / 2

    size = jnp.asarray(found.sensitivity)
    normal = size.T @ size + jnp.eye(found.place.size) / prior**2
    spread = jnp.linalg.cholesky(jnp.linalg.inv(normal))

    def one(key: Array) -> Array:
        begin, adapt, sample = jax.random.split(key, 3)
        offset = jax.random.normal(begin, found.place.shape)
        # in coordinates in which a linear model's posterior is round
        warm = blackjax.window_adaptation(
            blackjax.nuts, lambda round_: density(found.place + spread @ round_)
        )
        run: Any = warm.run  # whose annotations leave out its arguments
        (state, settings), _ = run(adapt, offset, tune)
        step = blackjax.nuts(
            lambda round_: density(found.place + spread @ round_), **settings
        ).step

        def draw(state: Any, key: Array) -> tuple[Any, Array]:
            state, _ = step(key, state)
            return state, found.place + spread @ state.position

        return jax.lax.scan(draw, state, jax.random.split(sample, draws))[1]

    key = a_key(key)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        # on which blackjax relies
        places = fast_compile(jax.vmap(one))(jax.random.split(key, chains))
    values = np.asarray(jax.vmap(jax.vmap(problem.unknowns.flat))(places))
    named = {name: values[..., k] for k, name in enumerate(found.names)}
    return arviz.from_dict(posterior=named)
