"""What a search minimises: how far a design is from what was measured on it."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanism.mechanism import Mechanism
from .measurement import Measurement
from .optimizer import Found
from .parameters import ParameterSet


class Problem(eqx.Module):
    """A design, what is unknown of it, and what was measured on it.

    Args:
        design: builds the mechanism from the unknowns.
        unknowns: from where they start.
        data: what was measured.
        held_out: what was measured as well, and takes no part.
        robust: standard deviations beyond which a reading counts by its size instead of
            its square, or nothing.
    """

    design: Callable[[Any], Mechanism]
    unknowns: ParameterSet
    data: tuple[Measurement, ...]
    held_out: tuple[Measurement, ...]
    robust: float | None = eqx.field(static=True)

    def tables(
        self, place: Float[Array, " unknowns"], *, forward: bool = True
    ) -> list[Float[Array, "rows columns"]]:
        """The residuals of each test, in standard deviations."""
        mechanism = self.design(self.unknowns.at(place))
        if not isinstance(mechanism, Mechanism):
            raise ValueError(
                f"`design` gave a {type(mechanism).__name__}, but must build a "
                "`Mechanism` from the unknowns."
            )
        tables = []
        for part in self.data:
            try:
                tables.append(part.residuals(mechanism, forward=forward))
            except ValueError as error:
                raise ValueError(f"{part.test!r}: {error}") from error
        return tables

    def residual(
        self, place: Float[Array, " unknowns"], *, forward: bool = True
    ) -> Float[Array, " readings"]:
        """The residuals in a row; half the sum of their squares is the loss.

        Of a robust loss, numbers whose squares are twice that: Huber's function of each.
        """
        tables = self.tables(place, forward=forward)
        row = jnp.concatenate([table.reshape(-1) for table in tables])
        if self.robust is None:
            return row
        far = jnp.abs(row) > self.robust
        size = jnp.where(far, jnp.abs(row), 1.0)
        linear = jnp.sqrt(self.robust * (2 * size - self.robust))
        return jnp.where(far, jnp.sign(row) * linear, row)

    def plain(self, residual: Float[Array, " readings"]) -> Float[Array, " readings"]:
        """The residuals of the readings, from those of a robust loss."""
        if self.robust is None:
            return residual
        far = jnp.abs(residual) > self.robust
        size = (residual**2 / self.robust + self.robust) / 2
        return jnp.where(far, jnp.sign(residual) * size, residual)

    def plain_slopes(self, found: Found) -> Float[Array, "readings unknowns"]:
        """The slopes of the readings' residuals, from those of a robust loss."""
        if self.robust is None:
            return found.slopes
        size = jnp.maximum(jnp.abs(found.residual), self.robust) / self.robust
        return found.slopes * size[:, None]

    def found(self, place: Float[Array, " unknowns"], *, forward: bool = True) -> Found:
        """The residual at a place, and its slopes."""
        if not forward:

            def loss(place: Array) -> tuple[Array, Array]:
                residual = self.residual(place, forward=False)
                return jnp.sum(residual**2) / 2, residual

            slopes, residual = jax.grad(loss, has_aux=True)(place)
            return Found(residual, slopes)

        def along(direction: Array) -> tuple[Array, Array]:
            return jax.jvp(self.residual, (place,), (direction,))

        residual, slopes = jax.vmap(along, out_axes=(None, 1))(jnp.eye(place.size))
        return Found(residual, slopes)
