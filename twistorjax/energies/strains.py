"""The three numbers by which a displacement strains a coupling, and their squares."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.types import Matrix, Scalar
from .._utils.validation import concrete
from ..geometry import se2
from ..geometry.twistors import Displacement


Coordinates = Literal["twist", "twistor"]


def strain(
    displacement: Displacement, coordinates: Coordinates
) -> tuple[Scalar, Scalar, Scalar]:
    """The three numbers whose square a quadratic energy takes."""
    turn = displacement.angle if coordinates == "twist" else 2 * displacement.xi
    longer = stretch(displacement, coordinates)
    return turn, 2 * longer * displacement.x1, 2 * longer * displacement.x2


def stretch(displacement: Displacement, coordinates: Coordinates) -> Scalar:
    """How much longer the translations of the coordinates are than those half way."""
    if coordinates == "twist":
        return 1 / se2.sinc(displacement.angle / 2, displacement.xi)
    return jnp.ones_like(displacement.angle)


def half_square(matrix: Matrix, vector: tuple[Scalar, Scalar, Scalar]) -> Scalar:
    """Half a quadratic form.

    Written out by scalars: batches of hinges then stay elementwise, and one loop on a
    processor. As a product of arrays it takes a fifth longer over a sweep of stages.
    """
    a, b, c = vector
    squares = matrix[0, 0] * a * a + matrix[1, 1] * b * b + matrix[2, 2] * c * c
    mixed = matrix[0, 1] * a * b + matrix[0, 2] * a * c + matrix[1, 2] * b * c
    return squares / 2 + mixed


def matrix_error(name: str, matrix: Float[Array, "... 3 3"]) -> str | None:
    """What keeps a matrix from being a stiffness or a damping, in words, or nothing."""
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
    # rotation and translation differ in unit, so by their size too: compare without it
    size = np.sqrt(np.abs(np.diagonal(values, axis1=-2, axis2=-1)))
    size = np.where(size > 0, size, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = values / size[..., :, None] / size[..., None, :]
        asymmetry = np.max(np.abs(scaled - np.swapaxes(scaled, -1, -2)))
    if asymmetry > 1e-9:
        return (
            f"`{name}` is not symmetric: {values.tolist()}. Use its symmetric part, "
            "`(matrix + matrix.T) / 2`; an antisymmetric part stores no energy."
        )
    # an entry off the diagonal that overflows here is larger than the diagonal allows
    lowest = -np.inf
    if np.all(np.isfinite(scaled)):
        lowest = np.linalg.eigvalsh(scaled / 2 + np.swapaxes(scaled, -1, -2) / 2).min()
    if lowest < -1e-9:
        return (
            f"`{name}` has a negative eigenvalue: {values.tolist()}. It would give "
            "energy away when displaced; every eigenvalue must be zero or positive."
        )
    return None
