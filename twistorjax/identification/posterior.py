"""Samples of the posterior distribution of the parameters."""

from typing import Any, TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._compile.compilation import fast_compile
from .._utils.progress import announced
from .._utils.types import KeyLike
from .._utils.validation import require_package
from .experiments.measurement import random_key
from .report import Identification


if TYPE_CHECKING:
    import arviz


@announced("posterior")
def posterior(
    identification: Identification,
    *,
    draws: int = 500,
    tune: int = 500,
    chains: int = 2,
    prior_standard_deviation: float = 3.0,
    key: KeyLike = 0,
) -> "arviz.InferenceData":
    """Draw samples of the posterior distribution by Hamiltonian Monte Carlo.

    Standard errors assume that the model is linear within the uncertainty of the
    parameters; the samples do not. The errors of the readings are normal, with the given
    standard deviations. The prior distribution of each normalized parameter is normal
    with mean zero, so a parameter with one bound has a shifted log-normal prior.

    Args:
        identification: Result of `identify` without Huber's loss. The chains start near
            its estimates.
        draws: Number of samples of each chain.
        tune: Number of earlier samples of each chain, which adapt the sampler and are not
            returned.
        chains: Number of chains, which run side by side.
        prior_standard_deviation: Prior standard deviation of the normalized parameters,
            as a relative change from the initial values.
        key: Random key, or an integer seed.

    Returns:
        The samples; `arviz.summary` reports their convergence.

    Raises:
        ImportError: blackjax or arviz is not installed.
        ValueError: The identification used Huber's loss.

    Source:
        Hoffman and Gelman, Journal of Machine Learning Research 15, 2014.
    """
    arviz, blackjax = (
        require_package(name, "Samples", "posterior") for name in ("arviz", "blackjax")
    )
    problem, center = identification.problem, identification.normalized
    if problem.huber_threshold is not None:
        raise ValueError(
            "Huber's loss is not the logarithm of a normal probability density: call "
            "`identify` without `huber_threshold` before sampling."
        )

    @jax.custom_jvp
    def loss(normalized: Array) -> Array:
        return problem.evaluate(normalized).loss

    @loss.defjvp
    def _(primals: Any, tangents: Any) -> tuple[Array, Array]:
        # The gradient is computed in forward mode, which is faster for few parameters.
        evaluation = problem.evaluate(primals[0])
        return evaluation.loss, evaluation.gradient @ tangents[0]

    def log_density(normalized: Array) -> Array:
        prior_loss = jnp.sum((normalized / prior_standard_deviation) ** 2) / 2
        return -loss(normalized) - prior_loss

    # The sampler works in coordinates in which the posterior distribution of the linear
    # model has the unit matrix as its covariance.
    jacobian = jnp.asarray(identification.jacobian)
    prior_information = jnp.eye(center.size) / prior_standard_deviation**2
    information = jacobian.T @ jacobian + prior_information
    factor = jnp.linalg.cholesky(jnp.linalg.inv(information))

    def whitened_log_density(whitened: Array) -> Array:
        return log_density(center + factor @ whitened)

    def run_chain(key: Array) -> Array:
        start_key, tune_key, draw_key = jax.random.split(key, 3)
        start = jax.random.normal(start_key, center.shape)
        adaptation = blackjax.window_adaptation(blackjax.nuts, whitened_log_density)
        run: Any = adaptation.run  # its annotations do not contain the arguments
        (state, settings), _ = run(tune_key, start, tune)
        step = blackjax.nuts(whitened_log_density, **settings).step

        def draw(state: Any, key: Array) -> tuple[Any, Array]:
            state, _ = step(key, state)
            return state, center + factor @ state.position

        return jax.lax.scan(draw, state, jax.random.split(draw_key, draws))[1]

    keys = jax.random.split(random_key(key), chains)
    # blackjax needs implicit promotion.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        samples = fast_compile(jax.vmap(run_chain), optimize=False)(keys)
    values = np.asarray(jax.vmap(jax.vmap(problem.parameters.vector))(samples))
    by_name = {name: values[..., k] for k, name in enumerate(identification.names)}
    return arviz.from_dict(posterior=by_name)
