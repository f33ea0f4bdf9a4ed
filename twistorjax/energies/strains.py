"""Strain coordinates of a hinge, and quadratic forms of them.

The strain of a hinge is a vector of three numbers, one for the rotation and two for the
translations along axis 1 and axis 2 of the hinge. It is either the twist of the
displacement or twice the vector part of the twistor.
"""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import concrete
from .._utils.types import Matrix, Scalar
from ..geometry import se2
from ..geometry.twistors import Displacement


Coordinates = Literal["twist", "twistor"]
Strain = tuple[Scalar, Scalar, Scalar]  # For rotation, axis 1, and axis 2; rad, m, m


def strain(displacement: Displacement, coordinates: Coordinates) -> Strain:
    """Compute the strain of a hinge for the rotation, axis 1, and axis 2; rad, m, m.

    It is the twist, or `2 (xi, x1, x2)` for the twistor.
    """
    rotation = displacement.angle if coordinates == "twist" else 2 * displacement.xi
    ratio = translation_scale(displacement, coordinates)
    return rotation, 2 * ratio * displacement.x1, 2 * ratio * displacement.x2


def translation_scale(displacement: Displacement, coordinates: Coordinates) -> Scalar:
    """Compute the ratio of the strain's translation to the mid-frame translation.

    It is one for the twistor, and the ratio of arc to chord for the twist.
    """
    if coordinates == "twist":
        return 1 / se2.sinc(displacement.angle / 2, displacement.sigma, displacement.xi)
    return jnp.ones_like(displacement.angle)


def half_square(matrix: Matrix, vector: tuple[Scalar, Scalar, Scalar]) -> Scalar:
    """Compute half a quadratic form, `vector . matrix . vector / 2`.

    It is an energy (J) for a stiffness and a strain, and half a power (W) for a damping
    and a strain rate. The sum is written out in scalars, so that XLA fuses it with other
    operations in a batch of hinges. With a matrix product a sweep of stages takes a fifth
    longer.
    """
    a, b, c = vector
    squares = matrix[0, 0] * a * a + matrix[1, 1] * b * b + matrix[2, 2] * c * c
    products = matrix[0, 1] * a * b + matrix[0, 2] * a * c + matrix[1, 2] * b * c
    return squares / 2 + products


def matrix_error(name: str, matrix: Float[Array, "... 3 3"]) -> str | None:
    """Describe why a matrix cannot be a stiffness or a damping; None if it can.

    Traced values are not checked. `name` is that of the argument.
    """
    if matrix.shape[-2:] != (3, 3):
        return (
            f"`{name}` has shape {matrix.shape}, but must be 3 by 3: a row and a column "
            "each for the rotation and for the translations along axis 1 and axis 2."
        )
    values = concrete(matrix)
    if values is None:
        return None
    if not np.all(np.isfinite(values)):
        return f"`{name}` has a value that is not finite: {values.tolist()}."
    # Rotation and translation have different units, so the matrix is scaled by its
    # diagonal.
    size = np.sqrt(np.abs(np.diagonal(values, axis1=-2, axis2=-1)))
    size = np.where(size > 0, size, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = values / size[..., :, None] / size[..., None, :]
        asymmetry = np.max(np.abs(scaled - np.swapaxes(scaled, -1, -2)))
    if asymmetry > 1e-9 and values.dtype == np.float32:
        return (
            f"`{name}` is in single precision. Enable double precision before you create "
            "any array: `twistorjax.configure()`."
        )
    if asymmetry > 1e-9:
        return (
            f"`{name}` is not symmetric: {values.tolist()}. Use its symmetric part, "
            "`(matrix + matrix.T) / 2`; an antisymmetric part stores no energy."
        )
    # An off-diagonal entry that overflows after scaling makes the matrix indefinite.
    lowest = -np.inf
    if np.all(np.isfinite(scaled)):
        lowest = np.linalg.eigvalsh(scaled / 2 + np.swapaxes(scaled, -1, -2) / 2).min()
    if lowest < -1e-9:
        return (
            f"`{name}` has a negative eigenvalue: {values.tolist()}. Every eigenvalue "
            "must be zero or positive, because a hinge is not a source of energy."
        )
    return None
