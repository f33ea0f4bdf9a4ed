"""Motion of a port along the travel of an input: gain, parasitic motion, lost motion."""

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compile.compilation import fast_compile
from .._utils.host import all_concrete, program_input
from .._utils.progress import announced
from .._utils.types import (
    BatchScalar,
    NumberLike,
    Numbers,
    Point,
    Pose,
    PoseLike,
    Poses,
    Scalar,
)
from .._utils.validation import index_of, require_choice, require_finite, require_pose
from ..geometry import se2
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load, prescribed_dofs
from ..mechanism.mechanism import COORDINATES, Mechanism
from ..mechanism.misfits import stroke_rows
from ..results.codes import RESULTS, Solution
from ..results.tables import cells, Column, Columns, Tabular
from .constraint_analysis import constraint_analysis
from .equations.state import warn_outside_linear_range
from .equilibrium import equilibrium
from .statics.errors import finish_equilibrium
from .statics.solution import Equilibrium


_UNITS = {"angle": "rad", "x": "m", "y": "m"}
_FARTHEST = 1e6  # printed center; the rotation about a farther one is a rounding error; m


class PortMotion(Solution, Tabular):
    """Motion of a port, a frame on a body, while an input moves through its travel.

    All quantities have one entry for each position of the input, from its start to its
    end. Coordinates of the port are measured in its frame at the start.

    Args:
        travel: Displacement of the input; rad or m.
        displacement: Displacement (angle, x, y) of the port from the start; rad, m, m.
        rate: Derivative of the displacement with respect to the travel.
        force: Force or moment of the input in the direction of its travel; N m or N.
        rigid_gain: Gain of the mechanism if the stiff directions of its hinges were
            rigid; None if it is unknown.
        result: `RESULTS.successful` or the reason of the failure at each position.
        body: Name of the body of the port.
        direction: Coordinate of the port that the input is meant to move.
        unit: Unit of the travel, "rad" or "m".
    """

    travel: Float[Array, "*batch positions"]
    displacement: Float[Array, "*batch positions 3"]
    rate: Float[Array, "*batch positions 3"]
    force: Float[Array, "*batch positions"]
    rigid_gain: BatchScalar | None
    result: RESULTS
    body: str = eqx.field(static=True)
    direction: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    _plural: ClassVar[str] = "positions of ports"
    _result_axes: ClassVar[int] = 1

    @property
    def output(self) -> Numbers:
        """Displacement of the port in its direction; rad or m."""
        return self.displacement[..., COORDINATES.index(self.direction)]

    @property
    def gain(self) -> Numbers:
        """Derivative of the output with respect to the travel."""
        return self.rate[..., COORDINATES.index(self.direction)]

    @property
    def parasitic(self) -> dict[str, Numbers]:
        """The two other coordinates of the displacement, by name; rad, m."""
        return {
            name: self.displacement[..., k]
            for k, name in enumerate(COORDINATES)
            if name != self.direction
        }

    @property
    def lost_motion(self) -> Numbers:
        """Travel that does not move the port, because hinges deform; rad or m.

        It is the travel minus the one with which the rigid mechanism would move the port
        as far, if its gain were that at the start. So the change of the gain with the
        travel is counted as well.

        Raises:
            ValueError: The gain of the rigid mechanism is unknown.
        """
        if self.rigid_gain is None:
            raise ValueError(
                "The lost motion needs the gain of the rigid mechanism, which is "
                "unknown. Give `rigid_gain` to `port_motion`, for example 1.0 if input "
                "and output are parallel."
            )
        return self.travel - self.output / self.rigid_gain[..., None]

    @property
    def center(self) -> Float[Array, "*batch positions 2"]:
        """Instantaneous center of rotation, infinite if the port does not rotate; m."""
        rotation, x, y = jnp.moveaxis(self.rate, -1, 0)
        rotates = rotation != 0
        safe = jnp.where(rotates, rotation, 1.0)
        arm = jnp.stack([-y / safe, x / safe], axis=-1)
        return jnp.where(rotates[..., None], self.displacement[..., 1:] + arm, jnp.inf)

    def columns(self) -> Columns:
        axes = ("travel",)
        table = {"travel": Column(self.travel, axes, self.unit)}
        for k, name in enumerate(COORDINATES):
            table[f"displacement_{name}"] = Column(
                self.displacement[..., k], axes, _UNITS[name]
            )
        table["gain"] = Column(self.gain, axes)
        table["force"] = Column(self.force, axes, self._force_unit)
        for k, name in enumerate(("center_x", "center_y")):
            table[name] = Column(self.center[..., k], axes, "m")
        if self.rigid_gain is not None:
            table["lost_motion"] = Column(self.lost_motion, axes, self.unit)
        return table

    @property
    def _force_unit(self) -> str:
        return "N m" if self.unit == "rad" else "N"

    def _summary(self, names: np.ndarray) -> str:
        del names
        travel, displacement, rate = map(
            np.asarray, (self.travel, self.displacement, self.rate)
        )
        index = COORDINATES.index(self.direction)
        first, last = rate[0, index], rate[-1, index]
        title = (
            f"port on {self.body!r}, direction {self.direction}: gain {first:.6g} at the "
            f"start, {last:.6g} at the end"
        )
        lines = [title]
        if self.rigid_gain is None:
            lines.append("lost motion: unknown; give `rigid_gain` to `port_motion`")
        else:
            lost = float(np.asarray(self.lost_motion)[-1])
            share = 100 * lost / travel[-1] if travel[-1] else 0.0
            lines.append(
                f"gain of the rigid mechanism {float(self.rigid_gain):.6g}; lost motion "
                f"at the end {lost:.4g} {self.unit}, {share:.4g} % of the travel"
            )
        heads = [f"travel ({self.unit})"]
        heads += [f"{name} ({unit})" for name, unit in _UNITS.items()]
        heads += ["gain", f"force ({self._force_unit})", "center x (m)", "center y (m)"]
        lines.append(" ".join(f"{head:>13}" for head in heads))
        force, center = np.asarray(self.force), np.asarray(self.center)
        for k in range(len(travel)):
            row = [travel[k], *displacement[k], rate[k, index], force[k], *center[k]]
            columns = cells(np.array(row))
            if np.max(np.abs(center[k])) > _FARTHEST:
                columns[-2:] = 2 * [f"{'-':>13}"]
            lines.append(" ".join(columns))
        lines.append("displacement and center in the axes of the port at its start")
        return "\n".join(lines)


@announced("port motion")
def port_motion(
    mechanism: Mechanism,
    body: str,
    at: PoseLike = (0.0, 0.0, 0.0),
    *,
    direction: str,
    drive: Drive | None = None,
    strokes: Mapping[str, PoseLike] = MappingProxyType({}),
    loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    time: NumberLike = 0.0,
    positions: int = 11,
    rigid_gain: NumberLike | None = None,
    throw: bool = True,
) -> PortMotion:
    """Compute how a port moves while an input moves through its travel.

    Args:
        mechanism: The mechanism.
        body: Name of the body of the port.
        at: Pose of the port in the frame of its body; rad, m, m.
        direction: Coordinate of the port that the input is meant to move: "angle", "x",
            or "y", in the axes of the port.
        drive: The input, a prescribed displacement of one coordinate at the end of the
            travel, which starts at zero; rad or m.
        strokes: The input, the stroke of one actuator at the end of the travel, instead
            of `drive`. The travel is the length of its translation, and the gain refers
            to this free stroke; rad, m, m.
        loads: Constant loads.
        constraints: Constraints between the bodies.
        time: Time at which time-dependent constraints are evaluated; s.
        positions: Number of positions of the input, at equal distances.
        rigid_gain: Gain of the mechanism if the stiff directions of its hinges were
            rigid, from which the lost motion is computed. By default it follows from
            `constraint_analysis` if there is a drive, no value is traced, and the rigid
            mechanism has exactly one motion that moves the input.
        throw: Whether a failure raises an error; otherwise it is reported by `result`,
            and the rows of the position are NaN.

    Returns:
        Displacement, gain, parasitic motion, and center of rotation at each position.

    Raises:
        ValueError: A name is unknown, or there is not exactly one input.
        RuntimeError: There is no equilibrium at a position.

    Example:
        >>> import numpy as np
        >>> from twistorjax import Body, Hinge, Quadratic
        >>> spring = Quadratic(np.diag([2.0, 50.0, 80.0]))
        >>> hinge = Hinge("spring", "base", "lever", spring, at=(0, 0, 0))
        >>> bodies = [Body("base"), Body("lever")]
        >>> lever = Mechanism(bodies, [hinge], fixed=["base"])
        >>> turn = Drive("lever", angle=0.1)
        >>> tip = port_motion(lever, "lever", (0, 0.2, 0), direction="y", drive=turn)
        >>> tip.gain[0], tip.parasitic["x"][-1]  # 0.2 m, 0.2 m (cos(0.1) - 1)
        (Array(0.2, dtype=float64), Array(-0.000999..., dtype=float64))
    """
    row = index_of("`body`", "body", body, mechanism.names)
    frame = require_pose("`at`", at)
    require_choice("direction", direction, COORDINATES)
    if positions < 2:
        raise ValueError(f"`positions` is {positions!r}, but must be at least 2.")
    if (drive is None) == (not strokes):
        raise ValueError(
            "There must be one input. Give either `drive`, a prescribed displacement of "
            "one coordinate, or `strokes`, the stroke of one actuator."
        )
    travel, dof, strokes_at_end = _input(mechanism, drive, strokes)
    path = _path(
        mechanism, row, frame, drive, strokes_at_end, tuple(loads), tuple(constraints),
        program_input(time, float), travel, dof, positions,
    )  # fmt: skip
    solution, displacement, rate, force = path
    finish_equilibrium(solution, throw)
    if throw:
        warn_outside_linear_range(mechanism, solution.range_shares)
    if rigid_gain is None and dof is not None:
        start = solution.displacements[0]
        gain = _rigid_gain(mechanism, row, frame, dof, start, constraints, time)
        gain = None if gain is None else gain[COORDINATES.index(direction)]
    else:
        gain = None if rigid_gain is None else require_finite("`rigid_gain`", rigid_gain)
    return PortMotion(
        travel=travel * jnp.linspace(0.0, 1.0, positions),
        displacement=displacement,
        rate=rate,
        force=force,
        rigid_gain=gain,
        result=solution.result,
        body=body,
        direction=direction,
        unit="rad" if dof is not None and dof % 3 == 0 else "m",
    )


def _input(
    mechanism: Mechanism, drive: Drive | None, strokes: Mapping[str, PoseLike]
) -> tuple[Scalar, int | None, Float[Array, "hinges 3"] | None]:
    """Return the travel (rad or m), and the degree of freedom or the strokes."""
    if drive is None:
        if len(strokes) != 1:
            raise ValueError(
                f"`strokes` has {len(strokes)} actuators, but the input is the stroke of "
                "one. Apply the others by `Mechanism.with_strokes`."
            )
        rows = stroke_rows(mechanism.hinge_names, strokes)
        travel = jnp.sqrt(jnp.sum(rows[:, 1:] ** 2))
        if (known := all_concrete([travel])) is not None and known[0] == 0:
            raise ValueError(
                f"The stroke of {next(iter(strokes))!r} has no translation, so it has no "
                "travel. Give a stroke along axis 1 or axis 2."
            )
        return travel, None, rows
    return *input_of_drive(mechanism, drive), None


def input_of_drive(mechanism: Mechanism, drive: Drive) -> tuple[Scalar, int]:
    """Return the displacement by a drive of one coordinate (rad or m), and its index."""
    dofs, targets = prescribed_dofs(mechanism, [drive])
    if len(dofs) != 1:
        raise ValueError(
            f"`drive` prescribes {', '.join(drive.coordinates)} of {drive.body!r}, but "
            "the input is one coordinate. Hold others by a `Slider` or a `Constraint`."
        )
    if (known := all_concrete([targets[0]])) is not None and known[0] == 0:
        raise ValueError(
            f"The drive of {drive.body!r} prescribes the displacement zero, so the input "
            "has no travel. Give its displacement at the end of the travel."
        )
    return targets[0], dofs[0]


@fast_compile
def _path(
    mechanism: Mechanism,
    body: int,
    frame: Pose,
    drive: Drive | None,
    strokes: Float[Array, "hinges 3"] | None,
    loads: tuple[Load, ...],
    constraints: tuple[AbstractConstraint, ...],
    time: Scalar,
    travel: Scalar,
    dof: int | None,
    positions: int,
) -> tuple[Equilibrium, Array, Array, Array]:
    """Compute equilibria, displacements, rates, and forces; see `PortMotion`."""

    def solve(share: Scalar) -> tuple[Poses, Equilibrium]:
        moved, drives = mechanism, []
        if drive is not None:
            drives = [jax.tree.map(lambda value: share * value, drive)]
        if strokes is not None:
            hinges = mechanism.hinge_assembly.with_strokes(share * strokes)
            moved = mechanism.with_hinges(hinges)
        solution = equilibrium(
            moved, loads=loads, drives=drives, constraints=constraints, time=time,
            throw=False,
        )  # fmt: skip
        return solution.displacements, solution

    def solve_with_rate(share: Scalar) -> tuple[Poses, Poses, Equilibrium]:
        return jax.jvp(solve, (share,), (jnp.ones_like(share),), has_aux=True)

    shares = jnp.linspace(0.0, 1.0, positions)
    displacements, rates, solution = jax.vmap(solve_with_rate)(shares)

    def actuator_force(strokes: Array, share: Scalar, displacements: Poses) -> Scalar:
        """Differentiate the elastic energy with respect to the travel."""

        def energy(share: Scalar) -> Scalar:
            hinges = mechanism.hinge_assembly.with_strokes(share * strokes)
            return hinges.energy(displacements)

        return jax.grad(energy)(share) / travel

    if strokes is not None:
        force = jax.vmap(partial(actuator_force, strokes))(shares, displacements)
    else:
        force = solution.reactions.reshape(positions, -1)[:, dof]
    angle = mechanism.reference[body, 0]
    displacement, rate = jax.vmap(
        displacement_and_rate, in_axes=(None, None, None, 0, 0)
    )(angle, frame, displacements[0, body], displacements[:, body], rates[:, body])
    return solution, displacement, rate / travel, force


def _rigid_gain(
    mechanism: Mechanism,
    body: int,
    frame: Pose,
    dof: int,
    start: Poses,
    constraints: Sequence[AbstractConstraint],
    time: NumberLike,
) -> Pose | None:
    """Compute the rate of a port per rate of a degree of freedom, with rigid hinges.

    The result is None if it is not unique, or if a value is traced.
    """
    leaves = jax.tree.leaves(eqx.filter(mechanism, eqx.is_array))
    if all_concrete([*leaves, frame, start]) is None or not np.all(np.isfinite(start)):
        return None
    analysis = constraint_analysis(
        mechanism, about=mechanism.reference + start, constraints=constraints, time=time
    )
    motions = analysis.motions * np.array([1.0, analysis.length, analysis.length])
    inputs = motions[:, dof // 3, dof % 3]
    (moving,) = np.nonzero(inputs)
    if len(moving) != 1:
        return None
    rate = jnp.asarray(motions[moving[0], body] / inputs[moving[0]])
    angle = mechanism.reference[body, 0]
    return displacement_and_rate(angle, frame, start[body], start[body], rate)[1]


def displacement_and_rate(
    reference: Scalar, frame: Pose, start: Pose, now: Pose, rate: Pose
) -> tuple[Pose, Pose]:
    """Compute displacement and rate of a port from those of its body (angle, x, y).

    `reference` is the angle of the body in the reference configuration; rad. `start` is
    the displacement of the body at the start of the travel; rad, m, m.
    """
    angle = now[0] - start[0]
    arm = se2.rotate(reference + start[0], frame[1:])
    turned = se2.rotation_displacement(tuple(arm), jnp.cos(angle / 2), jnp.sin(angle / 2))
    turned = jnp.stack(turned)
    translation = now[1:] - start[1:] + turned
    velocity = rate[1:] + rate[0] * _perpendicular(arm + turned)
    to_port = -(reference + start[0] + frame[0])
    displacement = jnp.append(angle, se2.rotate(to_port, translation))
    return displacement, jnp.append(rate[0], se2.rotate(to_port, velocity))


def _perpendicular(vector: Point) -> Point:
    """Rotate a vector by 90 degrees counterclockwise."""
    return jnp.stack([-vector[1], vector[0]])
