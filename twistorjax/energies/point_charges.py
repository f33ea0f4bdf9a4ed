"""Point charges on two bodies: an energy known exactly, with a pole at every pair."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.types import Point, Scalar
from .._utils.validation import concrete, require_positive
from ..geometry.twistors import Displacement
from .base import AbstractEnergy


VACUUM = 8.9875517862e9  # 1 / (4 pi epsilon_0); N m^2 / C^2


class PointCharges(AbstractEnergy):
    """Point charges on body A and on body B, of which each pulls at each of the other's.

    Charges of one body do not see one another. Where a site of A lies on one of B, the
    energy is infinite and the wrench has no value. That may be so at rest, when both
    frames coincide: such bodies have no stiffness there, and an equilibrium of theirs
    must be sought from elsewhere.

    Args:
        charges_a: of body A; C.
        sites_a: where they are, in frame a: a row (x, y) for each; m.
        charges_b: of body B, by default those of A; C.
        sites_b: where they are, in frame b, by default as on A; m.
        constant: of Coulomb's law, by default that of the vacuum; N m^2 / C^2. With
            another unit of charge or of length the energy has that of
            `constant * charge^2 / length`.

    Raises:
        ValueError: shapes do not fit, or a value is not finite.

    Source:
        Equations 7.16 and 7.19 of the dissertation.

    Example:
        >>> pair = PointCharges([2.0], [[0.0, 0.0]], [-3.0], [[0.0, 1.0]], constant=1.0)
        >>> pair(jnp.array([0.0, 0.0, 3.0]))  # 2 (-3) / (3 + 1)
        Array(-1.5, dtype=float64)
        >>> pair(jnp.array([jnp.pi, 0.0, 3.0]))  # turned to face one another
        Array(-3., dtype=float64)
    """

    charges_a: Float[Array, " a"]
    sites_a: Float[Array, "a 2"]
    charges_b: Float[Array, " b"]
    sites_b: Float[Array, "b 2"]
    constant: Scalar

    def __init__(
        self,
        charges_a: Float[ArrayLike, " a"] | Sequence[ArrayLike],
        sites_a: Float[ArrayLike, "a 2"] | Sequence[Sequence[ArrayLike]],
        charges_b: Float[ArrayLike, " b"] | Sequence[ArrayLike] | None = None,
        sites_b: Float[ArrayLike, "b 2"] | Sequence[Sequence[ArrayLike]] | None = None,
        *,
        constant: ArrayLike = VACUUM,
    ):
        if (charges_b is None) != (sites_b is None):
            lacking = "charges_b" if charges_b is None else "sites_b"
            raise ValueError(
                f"`{lacking}` are not given, but the other of `charges_b` and `sites_b` "
                "is: give both, or neither for a body B like A."
            )
        self.charges_a = jnp.asarray(charges_a, float)
        self.sites_a = jnp.asarray(sites_a, float)
        self.charges_b, self.sites_b = self.charges_a, self.sites_a
        if charges_b is not None and sites_b is not None:
            self.charges_b = jnp.asarray(charges_b, float)
            self.sites_b = jnp.asarray(sites_b, float)
        self.constant = require_positive("`constant`", constant)
        for body, charges, sites in (
            ("a", self.charges_a, self.sites_a),
            ("b", self.charges_b, self.sites_b),
        ):
            if charges.ndim != 1 or not charges.size:
                raise ValueError(
                    f"`charges_{body}` has shape {charges.shape}, but must be a list of "
                    "at least one charge."
                )
            if sites.shape != (len(charges), 2):
                raise ValueError(
                    f"`sites_{body}` has shape {sites.shape}, but for {len(charges)} "
                    f"charges must have {(len(charges), 2)}: a row (x, y) for each."
                )
        if fault := self.validation_error():
            raise ValueError(f"A `PointCharges` energy cannot be made: {fault}")

    def validation_error(self) -> str | None:
        """Which of its values is not finite, in words, or nothing."""
        for name in ("charges_a", "sites_a", "charges_b", "sites_b"):
            seen = concrete(getattr(self, name))
            if seen is not None and not np.all(np.isfinite(seen)):
                row = int(np.argwhere(~np.isfinite(seen))[0][0])
                return f"`{name}[{row}]` is {seen[row]}, but must be finite."
        return None

    def stored_energy(self, displacement: Displacement) -> Scalar:
        sigma, xi = displacement.sigma, displacement.xi

        def turned(site: Point, sine: Scalar) -> Point:
            x, y = site
            return jnp.stack([sigma * x - sine * y, sine * x + sigma * y])

        # in the axes half way between the frames
        here = jax.vmap(lambda site: turned(site, -xi))(self.sites_a)
        there = jax.vmap(lambda site: turned(site, xi))(self.sites_b)
        apart = 2 * jnp.stack([displacement.x1, displacement.x2])
        gaps = apart[None, None] + there[None] - here[:, None]
        distances = jnp.sqrt(jnp.sum(gaps**2, axis=2))
        products = self.charges_a[:, None] * self.charges_b[None]
        return self.constant * jnp.sum(products / distances)
