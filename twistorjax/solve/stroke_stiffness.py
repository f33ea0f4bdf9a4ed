"""Driving and support stiffness of a guide or a pivot over its stroke."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compile.compilation import fast_compile
from .._utils.host import program_input
from .._utils.progress import announced
from .._utils.types import NumberLike, Numbers, Pose, PoseLike, Scalar
from .._utils.validation import index_of, require_pose
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load
from ..mechanism.mechanism import COORDINATES, Mechanism
from ..results.codes import RESULTS, Solution
from ..results.tables import Column, Columns, Tabular
from .equations.state import warn_outside_linear_range
from .equilibrium import equilibrium
from .linearization import linearize_held
from .out_of_plane import hinges_not_known, HingesOutOfPlane, out_of_plane
from .port_compliance import compliance_in_port
from .port_motion import input_of_drive
from .statics.errors import finish_equilibrium
from .statics.solution import Equilibrium


_UNITS = {"angle": "N m/rad", "x": "N/m", "y": "N/m"}
# Heads of the columns of the printed table
_HEADS = {f"support_{name}": name for name in (*_UNITS, "z")}
_HEADS |= {f"support_rotation_{axis}": f"about {axis}" for axis in "12"}
_OUT_OF_PLANE = {"z": "N/m", "rotation_1": "N m/rad", "rotation_2": "N m/rad"}


class StrokeStiffness(Solution, Tabular):
    """Stiffness of a mechanism at a port, while a body is driven through its stroke.

    All quantities have one entry for each position, from the reference configuration to
    the end of the stroke. The compliances are in the axes of the port, while the drive
    holds its coordinate.

    Args:
        travel: Displacement by the drive; rad or m.
        force: Force or moment of the drive; N or N m.
        driving: Derivative of the force with respect to the travel; N/m or N m/rad.
        in_plane: Displacements (angle, x, y) of the port for unit wrenches (moment, fx,
            fy); rad/(N m), rad/N, m/N.
        out_of_plane: z, and rotations about axes 1 and 2, for a unit force along z and
            unit moments; None if the stiffness of a hinge out of the plane is not known;
            m/N, rad/N, rad/(N m).
        result: `RESULTS.successful` or the reason of the failure at each position.
        body: Name of the body of the port.
        driven: Coordinate of this body that the drive holds; empty if it drives another
            body.
        unit: Unit of the travel, "rad" or "m".
    """

    travel: Float[Array, "*batch positions"]
    force: Float[Array, "*batch positions"]
    driving: Float[Array, "*batch positions"]
    in_plane: Float[Array, "*batch positions 3 3"]
    out_of_plane: Float[Array, "*batch positions 3 3"] | None
    result: RESULTS
    body: str = eqx.field(static=True)
    driven: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    _plural: ClassVar[str] = "stiffnesses over strokes"
    _result_axes: ClassVar[int] = 1

    @property
    def support(self) -> dict[str, Numbers]:
        """Support stiffness of the port in each direction, by its name.

        It is the force or moment per displacement in this direction, while the port is
        free in all others, and the drive is held: "angle", "x", and "y" without the
        driven one, "z", "rotation_1", and "rotation_2"; N/m or N m/rad.
        """
        found = {}
        for k, name in enumerate(_UNITS):
            if name != self.driven:
                found[name] = 1 / self.in_plane[..., k, k]
        if self.out_of_plane is not None:
            for k, name in enumerate(_OUT_OF_PLANE):
                found[name] = 1 / self.out_of_plane[..., k, k]
        return found

    def columns(self) -> Columns:
        axes, rotates = ("travel",), self.unit == "rad"
        table = {
            "travel": Column(self.travel, axes, self.unit),
            "force": Column(self.force, axes, "N m" if rotates else "N"),
            "driving": Column(self.driving, axes, "N m/rad" if rotates else "N/m"),
        }
        units = {**_UNITS, **_OUT_OF_PLANE}
        for name, values in self.support.items():
            table[f"support_{name}"] = Column(values, axes, units[name])
        return table

    def _summary(self, names: np.ndarray) -> str:
        del names
        table = self.columns()
        title = f"stiffness at a port on {self.body!r}, which is free in other directions"
        lines = [f"{title} (N/m, N m/rad)"]
        lines.append(" ".join(f"{_HEADS.get(name, name):>10}" for name in table))
        values = [np.asarray(column.values) for column in table.values()]
        for row in zip(*values, strict=True):
            lines.append(" ".join(f"{value:>10.4g}" for value in row))
        if self.out_of_plane is None:
            lines.append("out of the plane: the stiffness of a hinge is not known")
        return "\n".join(lines)


@announced("stiffness over stroke")
def stiffness_over_stroke(
    mechanism: Mechanism,
    drive: Drive,
    at: PoseLike = (0.0, 0.0, 0.0),
    *,
    body: str | None = None,
    positions: int = 11,
    loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    time: NumberLike = 0.0,
    warping: bool = True,
    hinges: HingesOutOfPlane | None = None,
    fixed: Sequence[str] = (),
    throw: bool = True,
) -> StrokeStiffness:
    """Compute how stiff a guide or a pivot is over its stroke, in all directions.

    Flexures lose most of their support stiffness while they are deformed. This is the
    stiffness against the drive, and that of a port in the other directions of the plane
    and out of it, while the drive holds its coordinate.

    Args:
        mechanism: The mechanism.
        drive: The stroke: a displacement of one coordinate of a body; rad or m.
        at: Pose of the port in the frame of its body; rad, m, m. Forces through the
            center of compliance do not rotate the body, so it is the natural port: for
            two parallel leaves, the middle between them.
        body: Name of the body of the port; by default the one that is driven.
        positions: Number of positions, at equal distances from the reference
            configuration to the end of the stroke.
        loads: Constant loads.
        constraints: Constraints between the bodies in the plane. What they hold out of
            the plane is not known: name these bodies in `fixed`.
        time: Time at which time-dependent constraints are evaluated; s.
        warping: See `out_of_plane`.
        hinges: See `out_of_plane`.
        fixed: See `out_of_plane`.
        throw: Whether a failure raises an error; otherwise it is reported by `result`,
            and the rows of the position are NaN.

    Returns:
        The driving stiffness, and the compliances of the port in the plane and out of it.

    Raises:
        ValueError: A name is unknown, the drive prescribes several coordinates or zero,
            or `positions` is below 2.
        RuntimeError: There is no equilibrium at a position, or a body can move out of the
            plane without resistance.

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
        >>> stroke, middle = tj.Drive("table", y=4e-3), (0.0, -0.02, 0.0)
        >>> tj.stiffness_over_stroke(guide, stroke, middle, positions=3)
        stiffness at a port on 'table', which is free in other directions (N/m, N m/rad)
            travel      force    driving      angle          x          z    about 1 ...
                 0          0       1772   1.26e+04   3.15e+07  1.653e+06      661.5 ...
             0.002      3.552       1785       7142  1.785e+07  1.255e+06      503.8 ...
             0.004      7.157       1825       3082  7.703e+06  7.227e+05      293.1 ...
    """
    if positions < 2:
        raise ValueError(f"`positions` is {positions!r}, but must be at least 2.")
    travel, dof = input_of_drive(mechanism, drive)
    name = drive.body if body is None else body
    row = index_of("`body`", "body", name, mechanism.names)
    frame = require_pose("`at`", at)
    solution, driving, in_plane = _along(
        mechanism, drive, dof, row, frame, tuple(loads), tuple(constraints),
        program_input(time, float), positions,
    )  # fmt: skip
    finish_equilibrium(solution, throw)
    if throw:
        warn_outside_linear_range(mechanism, solution.range_shares)
    spatial = None
    if not hinges_not_known(mechanism, hinges):
        model = out_of_plane(
            mechanism, solution, warping=warping, hinges=hinges, fixed=fixed
        )
        spatial = model.compliance_at(name, frame)
    return StrokeStiffness(
        travel=travel * jnp.linspace(0.0, 1.0, positions),
        force=solution.reactions.reshape(positions, -1)[:, dof],
        driving=driving,
        in_plane=in_plane,
        out_of_plane=spatial,
        result=solution.result,
        body=name,
        driven=COORDINATES[dof % 3] if name == drive.body else "",
        unit="rad" if dof % 3 == 0 else "m",
    )


@fast_compile
def _along(
    mechanism: Mechanism,
    drive: Drive,
    dof: int,
    body: int,
    frame: Pose,
    loads: tuple[Load, ...],
    constraints: tuple[AbstractConstraint, ...],
    time: Scalar,
    positions: int,
) -> tuple[Equilibrium, Array, Array]:
    """Compute equilibria, the driving stiffness, and compliances in the plane."""
    coordinate = COORDINATES[dof % 3]
    unit_drive = Drive(drive.body, **{coordinate: 1.0})

    def stiffness(share: Scalar) -> tuple[Equilibrium, Scalar, Array]:
        drives = [jax.tree.map(lambda value: share * value, drive)]
        solution = equilibrium(
            mechanism, loads=loads, drives=drives, constraints=constraints, time=time,
            throw=False,
        )  # fmt: skip
        linear = linearize_held(
            mechanism, (dof,), {drive.body: [coordinate]}, solution, loads, constraints,
            time,
        )  # fmt: skip
        slope = linear(drives=[unit_drive], throw=False).reactions.reshape(-1)[dof]
        return solution, slope, compliance_in_port(linear, body, frame)

    return jax.vmap(stiffness)(jnp.linspace(0.0, 1.0, positions))
