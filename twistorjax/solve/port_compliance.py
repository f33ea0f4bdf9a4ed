"""Compliance and stiffness of a mechanism at a port: a frame on one of its bodies."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compile.compilation import fast_compile
from .._utils.host import all_concrete
from .._utils.progress import announced
from .._utils.types import BatchScalar, Matrix, NumberLike, Pose, PoseLike
from .._utils.validation import index_of, require_pose
from ..geometry import se2
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Load
from ..mechanism.mechanism import COORDINATES, Mechanism
from .linearization import Linearization, linearize_held
from .statics.solution import StateLike


class PortCompliance(eqx.Module):
    """Compliance of a mechanism at a port, a frame on one of its bodies.

    Args:
        compliance: Displacements (angle, x, y) of the port for unit wrenches (moment, fx,
            fy) about it, in the axes of the port; rad/(N m), rad/N, m/N.
        body: Name of the body.
    """

    compliance: Float[Array, "*batch 3 3"]
    body: str = eqx.field(static=True)

    @property
    def stiffness(self) -> Float[Array, "*batch 3 3"]:
        """Stiffness at the port, the inverse of the compliance; N m/rad, N/rad, N/m."""
        return jnp.linalg.inv(self.compliance)

    def stiffness_along(
        self, direction: str, held: Sequence[str] = ()
    ) -> Float[Array, "*batch"]:
        """Compute the force per displacement of one coordinate.

        Args:
            direction: Coordinate that is displaced: "angle", "x", or "y".
            held: Other coordinates that are held. The rest is free.

        Returns:
            The stiffness; N m/rad or N/m.

        Raises:
            ValueError: A coordinate is unknown, or the direction is held.
        """
        if isinstance(held, str) or direction in held:
            raise ValueError(
                f"`held` is {held!r}, but must be a list of other coordinates than "
                f"{direction!r}, such as ['angle']."
            )
        chosen = [
            index_of("`stiffness_along`", "coordinate", name, COORDINATES)
            for name in (direction, *held)
        ]
        free = [k for k in range(3) if k not in chosen[1:]]
        # The compliance of the coordinates that are not held, while the others are held.
        stiffness = self.stiffness[..., np.array(free)[:, None], np.array(free)]
        row = free.index(chosen[0])
        return 1 / jnp.linalg.inv(stiffness)[..., row, row]

    @property
    def center(self) -> Float[Array, "*batch 2"]:
        """Center of compliance, as seen from the port; m.

        A moment rotates the port about this point, and a force through this point
        displaces it without rotation.
        """
        rotation = self.compliance[..., 0, 0]
        x, y = self.compliance[..., 1, 0], self.compliance[..., 2, 0]
        return jnp.stack([-y / rotation, x / rotation], axis=-1)

    @property
    def rotational_stiffness(self) -> BatchScalar:
        """Moment per rotation of the free port; N m/rad."""
        return 1 / self.compliance[..., 0, 0]

    @property
    def principal_stiffnesses(self) -> Float[Array, "*batch 2"]:
        """Translational stiffnesses at the center, the larger one first; N/m."""
        return 1 / self._principal()[0]

    @property
    def principal_directions(self) -> Float[Array, "*batch 2 2"]:
        """Directions of the principal stiffnesses in the axes of the port, in rows."""
        return jnp.swapaxes(self._principal()[1], -1, -2)

    def _principal(self) -> tuple[Array, Array]:
        """Compute principal compliances and directions of forces through the center."""
        rotation = self.compliance[..., 0, 0]
        coupling = self.compliance[..., 1:, 0]
        outer = coupling[..., :, None] * coupling[..., None, :]
        at_center = self.compliance[..., 1:, 1:] - outer / rotation[..., None, None]
        values, vectors = jnp.linalg.eigh(at_center)
        return values, vectors

    def __repr__(self) -> str:
        known = all_concrete([self.compliance])
        if known is None or known[0].ndim > 2:
            return eqx.tree_pformat(self)
        center, stiffness = np.asarray(self.center), np.asarray(self.stiffness)
        first, second = np.asarray(self.principal_stiffnesses)
        x, y = np.asarray(self.principal_directions)[0]
        direction = np.degrees(np.arctan2(y, x))
        along = 1 / np.diagonal(known[0])[1:]
        lines = [
            f"port on {self.body!r}: center of compliance at ({center[0]:.6g}, "
            f"{center[1]:.6g}) m from it",
            f"rotational stiffness     {float(self.rotational_stiffness):.6g} N m/rad",
            f"principal stiffnesses    {first:.6g} N/m at {direction % 180:.4g} degrees, "
            f"{second:.6g} N/m across",
            f"if all else is free      {along[0]:.6g} N/m along x, {along[1]:.6g} N/m "
            "along y",
            "stiffness at the port    (N m/rad, N/rad, N/m)",
        ]
        lines += [" ".join(f"{value:>14.6g}" for value in row) for row in stiffness]
        return "\n".join(lines)


@announced("port compliance")
def port_compliance(
    mechanism: Mechanism,
    body: str,
    at: PoseLike = (0.0, 0.0, 0.0),
    *,
    prescribed: Sequence[str] | Mapping[str, Sequence[str]] = (),
    about: StateLike | None = None,
    loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    time: NumberLike = 0.0,
) -> PortCompliance:
    """Compute the compliance at a port, about an equilibrium.

    Args:
        mechanism: The mechanism.
        body: Name of the body of the port.
        at: Pose of the port in the frame of its body; rad, m, m.
        prescribed: Coordinates with prescribed displacements, which do not move; see
            `linearize`.
        about: Equilibrium or poses; by default the reference configuration; rad, m, m.
        loads: Loads that act at this equilibrium. The body of the port may also be held
            there by an unknown moment and an unknown force at its origin, which are
            constant.
        constraints: Constraints between the bodies.
        time: Time at which time-dependent constraints are evaluated; s.

    Returns:
        The compliance. It is NaN if the equilibrium is not stable.

    Raises:
        ValueError: There is no body of this name, a coordinate of the body is fixed or
            prescribed, or `linearize` raises an error.

    Source:
        In the plane, the center of compliance is the point at which rotation and
        translation decouple: Lipkin and Patterson, Trans. ASME, J. Mech. Des. 114, 1992.

    Example:
        >>> from twistorjax import Body, Hinge, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([2.0, 50.0, 80.0])))
        >>> hinge = Hinge("spring", "base", "table", spring, at=(0, 0.1, 0))
        >>> bodies = [Body("base"), Body("table")]
        >>> mechanism = Mechanism(bodies, [hinge], fixed=["base"])
        >>> port_compliance(mechanism, "table")
        port on 'table': center of compliance at (0.1, 0) m from it
        rotational stiffness     2 N m/rad
        principal stiffnesses    80 N/m at 90 degrees, 50 N/m across
        if all else is free      50 N/m along x, 57.1429 N/m along y
        stiffness at the port    (N m/rad, N/rad, N/m)
                   2.8              0              8
                     0             50              0
                     8              0             80
    """
    row = index_of("`body`", "body", body, mechanism.names)
    frame = require_pose("`at`", at)
    dofs = 3 * row, 3 * row + 1, 3 * row + 2
    linear = linearize_held(mechanism, dofs, prescribed, about, loads, constraints, time)
    held = [3 * row + k for k in range(3) if 3 * row + k not in linear.dofs.free]
    if held:
        names = " and ".join(mechanism.dof_name(dof) for dof in held)
        raise ValueError(
            f"The port is on {body!r}, but {names} cannot move, so its compliance has no "
            "inverse. Choose another body, or free this coordinate."
        )
    return PortCompliance(compliance_in_port(linear, row, frame), body)


@fast_compile
def compliance_in_port(linear: Linearization, body: int, frame: Pose) -> Matrix:
    """Compute the compliance of a frame on a body, in the axes of the frame.

    Coordinates of the body that are held do not move. The compliance is NaN if the
    equilibrium is not stable.
    """
    # The coordinates of a body are a twist about its origin, in the axes of the world.
    body_frame = linear.about[body] * jnp.array([1.0, 0.0, 0.0])
    rows = se2.adjoint(se2.inverse(se2.compose(body_frame, frame)))
    free = np.array(linear.dofs.free, int)
    moving = [k for k in range(3) if 3 * body + k in linear.dofs.free]
    columns = [int(np.flatnonzero(free == 3 * body + k)[0]) for k in moving]
    rows = rows[:, np.array(moving, int)]
    size = len(free) + len(linear.constraint_names)
    forces = jnp.zeros((3, size)).at[:, np.array(columns, int)].set(rows)
    response, stable = jax.vmap(linear.factors.solve_and_check)(forces)
    compliance = response[:, np.array(columns, int)] @ rows.T
    usable = jnp.all(stable) & linear.finite & linear.consistent
    return jnp.where(usable, (compliance + compliance.T) / 2, jnp.nan)
