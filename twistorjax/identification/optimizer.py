"""How a search for the smallest residual goes on, from one evaluation to the next.

Evaluations are costly and are compiled once; what is made of them is not, and is compiled
apart. So a step here is handed what was found, where optimistix and optax would call for
it, and says where to look next.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx
from jaxtyping import Array, Bool, Float


# Of sensitivities, in parts of the largest: smaller ones are rounding
NOTHING = 1e-10


def beyond_rounding(sizes: Float[Array, " sizes"]) -> Bool[Array, " sizes"]:
    """Which sensitivities are more than the rounding of the largest.

    Those are, too, of which a whole change moves the readings by a standard deviation.
    """
    return (sizes > NOTHING * jnp.max(sizes, initial=0.0)) | (sizes > 1)


class Found(eqx.Module):
    """What an evaluation found at a place.

    Args:
        residual: of each reading, in standard deviations.
        slopes: its derivatives by the place; or, where these are too many, those of half
            its square.
    """

    residual: Float[Array, " readings"]
    slopes: Float[Array, "*readings unknowns"]

    @property
    def loss(self) -> Float[Array, ""]:
        """Half the sum of squares; infinite where there is no answer."""
        square = jnp.sum(self.residual**2) / 2
        return jnp.where(jnp.isfinite(square), square, jnp.inf)

    @property
    def gradient(self) -> Float[Array, " unknowns"]:
        """Of the loss; zero where there is no answer."""
        slopes = self.slopes
        if slopes.ndim == 2:
            slopes = self.residual @ slopes
        return jnp.where(jnp.isfinite(self.loss), slopes, 0.0)


class AbstractDescent(eqx.Module):
    """A way from what was found at one place to the next."""

    @abstractmethod
    def begin(self, place: Float[Array, " unknowns"], found: Found) -> Any:
        """Its state before the first step."""

    @abstractmethod
    def step(
        self, place: Float[Array, " unknowns"], found: Found, state: Any
    ) -> tuple[Float[Array, " unknowns"], Any, Bool[Array, ""]]:
        """Where to look next, and whether the search has settled."""


class _Model(eqx.Module):
    """Of the residual about a place: a linear one, by its singular values.

    Of the unknowns as parts of what moves the residual by one, so that a badly scaled one
    is not damped more than the others.
    """

    place: Float[Array, " unknowns"]
    loss: Float[Array, ""]
    along: Float[Array, " least"]
    sizes: Float[Array, " least"]
    directions: Float[Array, "least unknowns"]
    damping: Float[Array, ""]
    ease: Float[Array, ""]
    edge: Bool[Array, ""]  # whether there was no answer somewhere on the way
    predicted: Float[Array, ""]


class Marquardt(AbstractDescent):
    """Levenberg's and Marquardt's method, by singular values.

    The least change of the place that the damped linear model asks for; of what has a
    bound, by no more than a factor of e. What the readings do not see stays as it is.
    optimistix's own of that name may be taken instead; it takes three times as long to
    compile, and four times the steps where residuals vanish, for its damping falls more
    slowly.

    Args:
        tolerance: it has settled when no step of the linear model is longer; or when none
            gains 1e-8 of what one reading adds to the loss, or 1e-8 where that is more:
            then the place is within a ten-thousandth of its standard error.
        bounded: one for each unknown with a bound, zero for the others.

    Source:
        Nocedal and Wright, Numerical Optimization, section 10.3; Moré, The
        Levenberg-Marquardt algorithm, Lecture Notes in Mathematics 630, 1978.
    """

    tolerance: float
    bounded: Float[Array, " unknowns"]

    def begin(self, place: Float[Array, " unknowns"], found: Found) -> _Model:
        least = min(found.slopes.shape)
        return _Model(
            place=place,
            loss=constant(np.inf),
            along=constant(np.zeros(least)),
            sizes=constant(np.zeros(least)),
            directions=constant(np.zeros((least, place.size))),
            damping=constant(1e-2),
            ease=constant(0.1),
            edge=constant(False),
            predicted=constant(0.0),
        )

    def step(
        self, place: Float[Array, " unknowns"], found: Found, state: _Model
    ) -> tuple[Float[Array, " unknowns"], _Model, Bool[Array, ""]]:
        gain = state.loss - found.loss
        better = jnp.isfinite(found.loss) & (gain > 1e-3 * state.predicted)
        slopes = jnp.where(jnp.isfinite(found.slopes), found.slopes, 0.0)
        slopes = slopes - _chased(found.residual, slopes)
        unit = jnp.sqrt(jnp.sum(slopes**2, axis=0))
        unit = jnp.where(beyond_rounding(unit), unit, jnp.inf)
        left, sizes, directions = jnp.linalg.svd(slopes / unit[None], full_matrices=False)
        first = jnp.isinf(state.loss)
        good = gain > 0.5 * state.predicted
        eased = jnp.where(first | ~good, 1.0, state.ease)
        fresh = _Model(
            place=place,
            loss=found.loss,
            along=found.residual @ left,
            sizes=sizes,
            directions=directions / unit[None],
            damping=state.damping * eased,
            ease=jnp.where(good, jnp.maximum(state.ease / 2, 0.1), state.ease),
            edge=state.edge,
            predicted=state.predicted,
        )
        edge = state.edge | ~jnp.isfinite(found.loss)
        again = eqx.tree_at(
            lambda old: (old.damping, old.ease, old.edge),
            state,
            (4 * state.damping, constant(0.5), edge),
        )
        model = jax.tree.map(lambda new, old: jnp.where(better, new, old), fresh, again)

        seen = model.sizes > NOTHING * jnp.max(model.sizes, initial=0.0)
        whole = jnp.where(seen, model.along, 0.0)
        damped = jnp.where(seen, model.sizes**2 + model.damping, 1.0)
        change = -whole * model.sizes / damped
        longest = jnp.max(jnp.abs(change @ model.directions) * self.bounded)
        change = change / jnp.maximum(1.0, longest)
        after = whole + model.sizes * change
        predicted = jnp.sum(whole**2 - after**2) / 2
        full = whole / jnp.where(seen, model.sizes, 1.0)
        left_over = jnp.sum(whole**2) / 2
        small = jnp.max(jnp.abs(full @ model.directions)) < self.tolerance
        small &= left_over <= 1e-4 + 1e-6 * model.loss
        each = jnp.minimum(1.0, model.loss / found.residual.size)
        flat = left_over <= 1e-8 * each
        # nothing to be gained that is not lost in the residual's own rounding
        stuck = ~better & (predicted < self.tolerance * model.loss) & ~model.edge
        model = eqx.tree_at(lambda model: model.predicted, model, predicted)
        return model.place + change @ model.directions, model, small | flat | stuck


def _chased(residual: Array, slopes: Array) -> Array:
    """The part of slopes by combinations of unknowns that are better left alone.

    What a thousandfold change of the unknowns would hardly show would be chased for ever
    along a curve of equal residuals, for less than a standard deviation of the readings.
    """
    left, sizes, directions = jnp.linalg.svd(slopes, full_matrices=False)
    lost = (sizes < 1e-3) & (jnp.abs(residual @ left) < 1)
    kept = jnp.where(lost, sizes, 0.0)
    return (left * kept[None]) @ directions


class Gradient(AbstractDescent):
    """Gradient descent by an optimiser of optax.

    Along the natural gradient, where the slopes of all readings are known: that measures
    a change of the unknowns by what it changes of the readings, so that a combination
    which is hardly seen takes no more steps than one that is seen well. `optax.sgd(1.0)`
    would be Gauss's and Newton's method, damped as long as residuals are large.

    Args:
        optimiser: its own.
        tolerance: it has settled when no step is longer.

    Source:
        Amari, Neural Computation 10, 1998; the damping of Yamashita and Fukushima,
        Computing Supplementum 15, 2001.
    """

    optimiser: optax.GradientTransformation = eqx.field(static=True)
    tolerance: float

    def begin(self, place: Float[Array, " unknowns"], found: Found) -> Any:
        del found
        return place, jax.tree.map(constant, self.optimiser.init(place)), constant(0.0)

    def step(
        self, place: Float[Array, " unknowns"], found: Found, state: Any
    ) -> tuple[Float[Array, " unknowns"], Any, Bool[Array, ""]]:
        last, inner, unit = state
        found, unit = _of_one(found, unit)
        gradient = found.gradient
        if found.slopes.ndim == 2:
            there = jnp.isfinite(found.loss)
            slopes = jnp.where(there, found.slopes, 0.0)
            residual = jnp.where(there, found.residual, 0.0)
            left, sizes, directions = jnp.linalg.svd(slopes, full_matrices=False)
            largest = jnp.max(sizes, initial=0.0)
            damped = sizes**2 + 1e-2 * jnp.sum(residual**2) * largest**2
            over = jnp.where(damped > 0, sizes / jnp.where(damped > 0, damped, 1.0), 0.0)
            gradient = (over * (residual @ left)) @ directions
        extended = optax.with_extra_args_support(self.optimiser)
        change: Any
        with jax.numpy_dtype_promotion("standard"):  # which optax relies on
            change, moved = extended.update(
                gradient, inner, place, value=found.loss, grad=gradient
            )
        lost = ~jnp.isfinite(found.loss)
        after = jnp.where(lost, (last + place) / 2, place + change)
        last, inner = jax.tree.map(
            lambda old, new: jnp.where(lost, old, new), (last, inner), (place, moved)
        )
        small = jnp.max(jnp.abs(change)) < self.tolerance
        return after, (last, inner, unit), small & ~lost


class Optimistix(AbstractDescent):
    """A least-squares method of optimistix that asks for the residual once a step.

    Args:
        solver: its own: `LevenbergMarquardt`, `Dogleg`, `GaussNewton` and their like.
    """

    solver: optx.AbstractLeastSquaresSolver

    def begin(self, place: Float[Array, " unknowns"], found: Found) -> Any:
        shape = jax.eval_shape(lambda: found.residual)
        inner = self.solver.init(_known, place, found, {}, shape, None, frozenset())
        return inner, place, constant(0.0)

    def step(
        self, place: Float[Array, " unknowns"], found: Found, state: Any
    ) -> tuple[Float[Array, " unknowns"], Any, Bool[Array, ""]]:
        del place
        inner, base, unit = state
        found, unit = _of_one(found, unit)
        lost = ~jnp.isfinite(found.loss)
        # where there is no answer: far from any
        residual = jnp.where(lost, 1e3, found.residual)
        slopes = jnp.where(lost, 0.0, found.slopes)
        found = Found(residual, slopes)
        base, inner, _ = self.solver.step(_known, base, found, {}, inner, frozenset())
        done, _ = self.solver.terminate(_known, base, found, {}, inner, frozenset())
        return inner.y_eval, (inner, base, unit), done


def _of_one(found: Found, unit: Float[Array, ""]) -> tuple[Found, Float[Array, ""]]:
    """What was found, of size one at the start, as methods that are not of any size want.

    Args:
        found: in standard deviations.
        unit: the size at the start, or zero before it is known.
    """
    size = jnp.sqrt(2 * found.loss)
    usable = jnp.isfinite(size) & (size > 0)
    unit = jnp.where((unit == 0) & usable, jnp.where(usable, size, 1.0), unit)
    scale = jnp.where(unit > 0, unit, 1.0)
    slopes = found.slopes / (scale**2 if found.slopes.ndim == 1 else scale)
    return Found(found.residual / scale, slopes), unit


def _known(place: Float[Array, " unknowns"], found: Found) -> tuple[Array, None]:
    """The residual at the place where it was found, with its slopes."""

    @jax.custom_jvp
    def residual(place):
        del place
        return found.residual

    @residual.defjvp
    def _(place, moved):
        del place
        return found.residual, found.slopes @ moved[0]

    return residual(place), None


def constant(value: Any) -> Array:
    """An array that is not computed: `jax.numpy.zeros` compiles a program."""
    return jnp.asarray(np.asarray(value))
