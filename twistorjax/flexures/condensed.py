"""Exact energy of a sub-mechanism as a function of the displacement of its two ends."""

from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.pytrees import largest_of
from .._utils.types import Flag, Matrix, Pose, Poses, Scalar
from ..energies.base import AbstractEnergy
from ..geometry.twistors import Displacement
from ..mechanism.mechanism import Mechanism
from ..mechanism.sub_mechanism import SubMechanism
from ..solve.equilibrium import inner_displacements


class Condensed(AbstractEnergy):
    """The energy of a sub-mechanism whose inner bodies are in equilibrium.

    It is the smallest energy of all hinges at a displacement of body B relative to body
    A. Its derivative is the wrench of the hinges on body B at this equilibrium (envelope
    theorem), and its stiffness is the Schur complement of that of the sub-mechanism.
    Derivatives of all orders are exact. The energy is valid where all hinges are in their
    validity ranges. If no stable equilibrium is found, the energy is NaN. It is followed
    while the displacement increases in proportion, so that a large stroke of stages in
    series may lead through states in which leaves buckle.

    An evaluation solves for the equilibrium of the inner bodies; `surrogate` makes a fast
    energy of a sub-mechanism.

    Args:
        part: The sub-mechanism.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> bodies = [tj.Body("frame"), tj.Body("middle"), tj.Body("stage")]
        >>> series = tj.Mechanism(
        ...     bodies,
        ...     [
        ...         tj.Hinge("first", "frame", "middle", leaf, at=(0, -0.1, 0)),
        ...         tj.Hinge("second", "middle", "stage", leaf, at=(0, 0.1, 0)),
        ...     ],
        ...     fixed=["frame"],
        ... )
        >>> energy = Condensed(tj.SubMechanism(series, "stage", at=(0, 0, 0)))
        >>> both, single = energy.tangent_stiffness(), leaf.tangent_stiffness()
        >>> both[0, 0] / single[0, 0], both[1, 1] / single[1, 1]
        (Array(0.5, dtype=float64), Array(0.5, dtype=float64))
    """

    part: SubMechanism
    _parts_are_displaced_alike: ClassVar[bool] = False

    def stored_energy(self, displacement: Displacement) -> Scalar:
        part = self.part.without_ranges()
        return _energy(part, self.part.second, displacement.pose())

    def out_of_range(self, displacement: Displacement) -> Flag:
        """Decide whether a hinge of the sub-mechanism is out of its validity range."""
        hinges = self.part.mechanism.hinge_assembly
        return jnp.any(hinges.out_of_range(self._displacements(displacement)))

    def range_message(self, displacement: Displacement) -> str:
        """Describe the displacements of the hinges that are out of range."""
        mechanism = self.part.mechanism
        return mechanism.range_messages(
            mechanism.reference + self._displacements(displacement)
        ).rstrip(".")

    def range_share(self, displacement: Displacement) -> Scalar | None:
        """Compute the largest share of a hinge of the sub-mechanism."""
        hinges = self.part.mechanism.hinge_assembly
        shares = hinges.range_shares(self._displacements(displacement))
        return None if shares is None else largest_of(shares)

    def _displacements(self, displacement: Displacement) -> Poses:
        """Compute the displacements of all bodies; rad, m, m."""
        mechanism = self.part.without_ranges()
        return inner_displacements(mechanism, self.part.second, displacement.pose())


def reference_stiffness(part: SubMechanism) -> Matrix:
    """Compute the stiffness of a sub-mechanism in its reference configuration.

    It is the Schur complement of the stiffness of all bodies but body A.
    """
    block, coupling, at_end = _blocks(part)
    if not len(block):
        return at_end
    return at_end - coupling.T @ jnp.linalg.solve(block, coupling)


@jax.jit
def drawn_displacements(part: SubMechanism, pose: Pose) -> Poses:
    """Compute the equilibrium of the inner bodies, or that of the linear mechanism.

    The linear one is for drawings of magnified displacements, for which there may be no
    equilibrium.
    """
    exact = inner_displacements(part.without_ranges(), part.second, pose)
    block, coupling, _ = _blocks(part)
    row = part.mechanism.index(part.second)
    linear = jnp.zeros_like(exact).at[row].set(pose)
    if inner := _inner_rows(part):
        moved = -jnp.linalg.solve(block, coupling @ pose).reshape(-1, 3)
        linear = linear.at[jnp.asarray(inner)].set(moved)
    return jnp.where(jnp.all(jnp.isfinite(exact)), exact, linear)


def _inner_rows(part: SubMechanism) -> list[int]:
    outer = part.first, part.second
    return [k for k, name in enumerate(part.mechanism.names) if name not in outer]


def _blocks(
    part: SubMechanism,
) -> tuple[Float[Array, "inner inner"], Float[Array, "inner 3"], Matrix]:
    """Return the blocks of the stiffness in the reference configuration.

    They are those of the inner bodies, of inner bodies and body B, and of body B.
    """
    mechanism = part.mechanism
    matrix = mechanism.stiffness(mechanism.reference)
    end, rows = mechanism.index(part.second), np.array(_inner_rows(part), int)
    size = 3 * len(rows)
    block = matrix[rows][:, :, rows].reshape(size, size)
    return block, matrix[rows][:, :, end].reshape(size, 3), matrix[end, :, end, :]


@eqx.filter_custom_jvp
def _energy(mechanism: Mechanism, second: str, pose: Pose) -> Scalar:
    """Compute the energy at a pose of frame b relative to frame a (rad, m, m); J."""
    inner = inner_displacements(mechanism, second, pose)
    return _energy_at(inner, second, mechanism, pose)


@_energy.def_jvp
def _energy_jvp(primals, tangents):
    # At the equilibrium, the derivative with respect to the inner bodies is zero.
    mechanism, second, pose = primals
    inner = inner_displacements(mechanism, second, pose)
    energy, rate = eqx.filter_jvp(
        partial(_energy_at, inner, second), (mechanism, pose), (tangents[0], tangents[2])
    )
    return energy, jnp.zeros_like(energy) if rate is None else rate


def _energy_at(inner: Poses, second: str, mechanism: Mechanism, pose: Pose) -> Scalar:
    """Compute the energy at given displacements of the inner bodies (rad, m, m); J."""
    displacements = inner.at[mechanism.index(second)].set(pose)
    return mechanism.hinge_assembly.energy(displacements)
