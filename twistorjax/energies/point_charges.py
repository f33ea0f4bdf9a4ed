"""Energy of point charges on two bodies.

The energy is known in closed form and is singular if the positions of two charges are
equal. It is a test case for rational fits.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from typing_extensions import TypeAliasType

from .._utils.host import concrete
from .._utils.types import NumberLike, Point, Scalar
from .._utils.validation import require_positive
from ..geometry.twistors import Displacement
from .base import AbstractEnergy


COULOMB_CONSTANT = 8.9875517862e9  # 1 / (4 pi epsilon_0); N m^2 / C^2


# Charges (C) and a row (x, y) for each of them (m), on bodies A and B
ChargesALike = TypeAliasType("ChargesALike", Float[ArrayLike, " a"] | Sequence[ArrayLike])
SitesALike = TypeAliasType(
    "SitesALike", Float[ArrayLike, "a 2"] | Sequence[Sequence[ArrayLike]]
)
ChargesBLike = TypeAliasType("ChargesBLike", Float[ArrayLike, " b"] | Sequence[ArrayLike])
SitesBLike = TypeAliasType(
    "SitesBLike", Float[ArrayLike, "b 2"] | Sequence[Sequence[ArrayLike]]
)


class PointCharges(AbstractEnergy):
    """Electrostatic energy of point charges on body A with point charges on body B.

    Charges on the same body do not interact, because their distances are constant. If a
    charge of A and a charge of B have the same position, the energy is infinite and the
    wrench is undefined. This may happen in the reference configuration, where frames a
    and b coincide. The stiffness is then undefined, so an equilibrium must be computed
    from another `start`.

    Args:
        charges_a: Charges on body A; C.
        sites_a: Positions of these charges in frame a, a row (x, y) for each; m.
        charges_b: Charges on body B, by default those of A; C.
        sites_b: Positions of these charges in frame b, by default those of A; m.
        constant: Coulomb constant, by default that of the vacuum; N m^2 / C^2. In other
            units of charge and length, the unit of the energy is that of
            `constant * charge^2 / length`.

    Raises:
        ValueError: The shapes do not match, or a value is not finite.

    Source:
        Equations 7.16 and 7.19 of the dissertation.

    Example:
        >>> pair = PointCharges(
        ...     charges_a=[2.0],
        ...     sites_a=[[0.0, 0.0]],
        ...     charges_b=[-3.0],
        ...     sites_b=[[0.0, 1.0]],
        ...     constant=1.0,
        ... )
        >>> pair(jnp.array([0.0, 0.0, 3.0]))  # at the distance 3 + 1
        Array(-1.5, dtype=float64)
        >>> pair(jnp.array([jnp.pi, 0.0, 3.0]))  # at the distance 3 - 1
        Array(-3., dtype=float64)
    """

    charges_a: Float[Array, " a"]
    sites_a: Float[Array, "a 2"]
    charges_b: Float[Array, " b"]
    sites_b: Float[Array, "b 2"]
    constant: Scalar

    def __init__(
        self,
        charges_a: ChargesALike,
        sites_a: SitesALike,
        charges_b: ChargesBLike | None = None,
        sites_b: SitesBLike | None = None,
        *,
        constant: NumberLike = COULOMB_CONSTANT,
    ):
        if (charges_b is None) != (sites_b is None):
            names = ("charges_b", "sites_b")
            missing, given = names if charges_b is None else reversed(names)
            raise ValueError(
                f"`{missing}` is not given, but `{given}` is. Give both, or neither if "
                "body B has the same charges as body A."
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
        if error := self.validation_error():
            raise ValueError(f"A `PointCharges` energy cannot be created: {error}")

    def validation_error(self) -> str | None:
        """Describe the first value that is not finite; None if all are finite."""
        for name in ("charges_a", "sites_a", "charges_b", "sites_b"):
            values = concrete(getattr(self, name))
            if values is not None and not np.all(np.isfinite(values)):
                row = int(np.argwhere(~np.isfinite(values))[0][0])
                return f"`{name}[{row}]` is {values[row]}, but must be finite."
        return None

    def stored_energy(self, displacement: Displacement) -> Scalar:
        cos, sin = displacement.sigma, displacement.xi

        def rotate(site: Point, sin: Scalar) -> Point:
            x, y = site
            return jnp.stack([cos * x - sin * y, sin * x + cos * y])

        # All positions are resolved in the mid-frame.
        positions_a = jax.vmap(lambda site: rotate(site, -sin))(self.sites_a)
        positions_b = jax.vmap(lambda site: rotate(site, sin))(self.sites_b)
        translation = 2 * jnp.stack([displacement.x1, displacement.x2])
        gaps = translation[None, None] + positions_b[None] - positions_a[:, None]
        distances = jnp.sqrt(jnp.sum(gaps**2, axis=2))
        products = self.charges_a[:, None] * self.charges_b[None]
        return self.constant * jnp.sum(products / distances)
