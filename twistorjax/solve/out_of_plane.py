"""Stiffness of a mechanism out of its plane, about an equilibrium in the plane."""

from collections.abc import Mapping, Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compile.compilation import fast_compile
from .._utils.host import concrete
from .._utils.progress import announced
from .._utils.types import MatrixLike, Pose, PoseLike, PosesOrResult
from .._utils.validation import index_of, listing, require_array, require_pose
from ..assembly.assembly import HingeAssembly
from ..assembly.out_of_plane import assembled_stiffness, Given, hinges_without_stiffness
from ..geometry import se2
from ..linalg.factors import Factors
from ..mechanism.mechanism import Mechanism


# Smaller eigenvalues of a stiffness with ones on its diagonal may be rounding errors.
_SINGULAR = 1e-12


class OutOfPlane(eqx.Module):
    """Stiffness of a mechanism against displacements out of its plane.

    These are z and the rotations about x and y of each body, at its displaced origin; m,
    rad, rad.

    Args:
        stiffness: Forces along z (N) and moments about x and y (N m) on the bodies, for
            unit displacements.
        poses: Poses of the bodies in the plane; rad, m, m.
        names: Names of the bodies.
        fixed: Indices of the bodies that cannot move out of the plane.
    """

    stiffness: Float[Array, "*batch dofs dofs"]
    poses: Float[Array, "*batch bodies 3"]
    names: tuple[str, ...] = eqx.field(static=True)
    fixed: tuple[int, ...] = eqx.field(static=True)

    @property
    def _free(self) -> list[int]:
        """Indices of the bodies that can move out of the plane."""
        return [row for row in range(len(self.names)) if row not in self.fixed]

    @property
    def _free_stiffness(self) -> Float[Array, "*batch free free"]:
        """Stiffness of the bodies that can move out of the plane."""
        dofs = np.ravel(3 * np.array(self._free)[:, None] + np.arange(3))
        return self.stiffness[..., dofs[:, None], dofs]

    def __repr__(self) -> str:
        fixed = listing(self.names[row] for row in self.fixed)
        return f"stiffness out of the plane of {len(self.names)} bodies; fixed: {fixed}"

    def compliance_at(
        self, body: str, at: PoseLike = (0.0, 0.0, 0.0)
    ) -> Float[Array, "*batch 3 3"]:
        """Compute the compliance at a port, a frame on a body that can move.

        Args:
            body: Name of the body.
            at: Pose of the port in the frame of its body; rad, m, m.

        Returns:
            Displacements of the port along z, and its rotations about its axes 1 and 2,
            for a unit force along z and unit moments about these axes; m/N, rad/N, rad/(N
            m). It is NaN if the stiffness is not positive definite.

        Raises:
            ValueError: There is no such body, or it cannot move.
        """
        row = index_of("`body`", "body", body, self.names)
        if row in self.fixed:
            raise ValueError(
                f"The port is on {body!r}, which cannot move, so its compliance has no "
                "inverse. Choose another body."
            )
        port, stiffness = require_pose("`at`", at), self._free_stiffness
        *batch, size, _ = stiffness.shape
        found = jax.vmap(partial(_compliance, self._free.index(row), port))(
            stiffness.reshape(-1, size, size), self.poses[..., row, :].reshape(-1, 3)
        )
        return found.reshape(*batch, 3, 3)

    def stiffness_at(
        self, body: str, at: PoseLike = (0.0, 0.0, 0.0)
    ) -> Float[Array, "*batch 3 3"]:
        """Compute the stiffness at a port, the inverse of `compliance_at`.

        Args:
            body: Name of the body.
            at: Pose of the port in the frame of its body; rad, m, m.

        Returns:
            The force along z and the moments about axes 1 and 2 of the port for unit
            displacements; N/m, N/rad, N m/rad.

        Raises:
            ValueError: There is no such body, or it cannot move.
        """
        return jnp.linalg.inv(self.compliance_at(body, at))

    def _require_support(self) -> None:
        """Raise an error if a body can move out of the plane without resistance."""
        stiffness = concrete(self._free_stiffness)
        if stiffness is None or not np.all(np.isfinite(stiffness)):
            return
        for matrix in stiffness.reshape(-1, *stiffness.shape[-2:]):
            sizes = np.maximum(np.abs(np.diagonal(matrix)), np.finfo(float).tiny)
            scale = 1 / np.sqrt(sizes)
            values, vectors = np.linalg.eigh(scale[:, None] * matrix * scale[None])
            if values[0] <= _SINGULAR:
                parts = np.linalg.norm(vectors[:, 0].reshape(-1, 3), axis=1)
                rows = np.flatnonzero(parts > 0.1 * np.max(parts))
                moving = [self._free[k] for k in rows]
                raise RuntimeError(
                    f"{listing(self.names[row] for row in moving)} can move out of the "
                    "plane without resistance. Connect it to fixed bodies by flexures, "
                    "or name it in `fixed`."
                )


@announced("out-of-plane stiffness")
def out_of_plane(
    mechanism: Mechanism,
    about: PosesOrResult | None = None,
    *,
    warping: bool = True,
    hinges: Mapping[str, MatrixLike] | None = None,
    fixed: Sequence[str] = (),
) -> OutOfPlane:
    """Compute the stiffness of a mechanism out of its plane.

    To first order, the displacements out of the plane of a mechanism that is symmetric
    about the middle plane of its plate are independent of those in the plane; their
    stiffness depends on the deformed state in the plane, because a force along z twists a
    bent leaf. This is why a guide loses most of its support stiffness at the end of its
    stroke. See `flexures.out_of_plane_stiffness` for the theory and its errors.

    Bodies whose three coordinates in the plane are fixed cannot move out of it either.
    All others can, also if some of their coordinates are fixed.

    Args:
        mechanism: The mechanism.
        about: Equilibrium, motion, or poses of the bodies; by default the reference
            configuration; rad, m, m.
        warping: Whether the ends of the flexures cannot warp, because they are clamped to
            thick bodies.
        hinges: Stiffness of hinges that were not created from dimensions, by their names:
            force along z and moments about axes 1 and 2 in the frame of the hinge, for
            unit displacements; N/m, N/rad, N m/rad. It replaces the one that follows from
            dimensions.
        fixed: Further bodies that cannot move out of the plane.

    Returns:
        The stiffness, with an axis in front for the times of a motion or a batch.

    Raises:
        ValueError: The stiffness of a hinge is not known, a name is unknown, or all
            bodies are fixed.
        RuntimeError: A body can move out of the plane without resistance.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> leaf = tj.flexures.leaf(steel, length=40e-3, thickness=0.3e-3, width=10e-3)
        >>> bodies = [tj.Body("wall"), tj.Body("table", (0.0, 0.04, 0.02))]
        >>> leaves = [
        ...     tj.Hinge(name, "wall", "table", leaf, at=(0.0, 0.02, y))
        ...     for name, y in (("lower", 0.0), ("upper", 0.04))
        ... ]
        >>> guide = tj.Mechanism(bodies, leaves, fixed=["wall"])
        >>> middle = 0.0, -0.02, 0.0  # of the leaves, in the frame of the table
        >>> out_of_plane(guide).stiffness_at("table", middle)[0, 0].round(-3)  # N/m
        Array(1653000., dtype=float64)
        >>> pushed = tj.equilibrium(guide, drives=[tj.Drive("table", y=4e-3)])
        >>> out_of_plane(guide, pushed).stiffness_at("table", middle)[0, 0].round(-3)
        Array(732000., dtype=float64)
    """
    assembly, names = mechanism.hinge_assembly, mechanism.hinge_names
    given: Given = {}
    for name, matrix in (hinges or {}).items():
        row = index_of("`hinges`", "hinge", name, names)
        given[row] = require_array(
            f"`hinges[{name!r}]`", matrix, (3, 3), "be a matrix with three rows"
        )
    unknown = [row for row in hinges_without_stiffness(assembly) if row not in given]
    if unknown:
        raise ValueError(
            f"The stiffness out of the plane of {listing(names[row] for row in unknown)} "
            "is not known. Create the energies from dimensions, by `flexures.leaf`, "
            "`flexures.notch`, or `flexures.surrogate`, or give it in `hinges`."
        )
    held = {index_of("`fixed`", "body", name, mechanism.names) for name in fixed}
    for row in range(len(mechanism.names)):
        if {3 * row, 3 * row + 1, 3 * row + 2} <= set(mechanism.fixed):
            held.add(row)
    if len(held) == len(mechanism.names):
        raise ValueError("All bodies are fixed, so none can move out of the plane.")
    at = mechanism.reference if about is None else about
    stiffness = mechanism.of_hinges(at, partial(_stiffness, given, warping))
    poses = mechanism.displacements(at, "about") + mechanism.reference
    result = OutOfPlane(stiffness, poses, mechanism.names, tuple(sorted(held)))
    result._require_support()
    return result


@fast_compile
def _stiffness(
    given: Given, warping: bool, hinges: HingeAssembly, displacements: Array
) -> Array:
    return assembled_stiffness(hinges, displacements, warping, given)


def _compliance(index: int, port: Pose, stiffness: Array, pose: Pose) -> Array:
    """Compute the compliance of a port on one of the bodies that can move."""
    rows = slice(3 * index, 3 * index + 3)
    factors = Factors.of(stiffness, symmetric=True)
    compliance = factors.solve(jnp.eye(len(stiffness))[:, rows])[rows]
    frame = se2.compose(pose * jnp.array([1.0, 0.0, 0.0]), port)
    angle, x, y = frame
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    moved = jnp.array([[one, y, -x], [zero, cos, sin], [zero, -sin, cos]])
    return moved @ compliance @ moved.T
