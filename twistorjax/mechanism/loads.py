"""Loads on the bodies of a mechanism, and prescribed displacements."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import as_float, concrete
from .._utils.types import (
    ForceLike,
    NumberLike,
    Point,
    PointLike,
    Poses,
    Scalar,
    Wrench,
    Wrenches,
    WrenchLike,
)
from .._utils.validation import index_of, require_kind, require_row
from .mechanism import COORDINATES, Mechanism


class Load(eqx.Module):
    """A force and a moment on a body.

    Args:
        body: Name of the body.
        wrench: Moment about the point `at` and force as one row (moment, fx, fy); N m, N,
            N. Give either this, or `force` and `moment`.
        at: Point on which the force acts, in the frame of the body; by default its
            origin; m.
        force: Force (fx, fy); by default zero; N. It is in world axes, or in the axes of
            the body if `follower` is True.
        moment: Moment; by default zero; N m.
        follower: If True, the force rotates with the body, as that of a pressure does. If
            False, its direction in the world is constant, as that of a weight is.

    Raises:
        ValueError: Both or neither of `wrench` and its parts are given, a shape is wrong,
            or a value is not finite.

    Example:
        >>> Load("stage", force=(1.0, 0.0)).wrench
        Array([0., 1., 0.], dtype=float64)
    """

    body: str = eqx.field(static=True)
    wrench: Wrench
    at: Point
    follower: bool = eqx.field(static=True)

    def __init__(
        self,
        body: str,
        wrench: WrenchLike | None = None,
        at: PointLike = (0.0, 0.0),
        *,
        force: ForceLike | None = None,
        moment: NumberLike | None = None,
        follower: bool = False,
    ):
        self.body = body
        where = f"of the load on {body!r}"
        parts = force is not None or moment is not None
        if (wrench is None) != parts:
            raise ValueError(
                f"The load on {body!r} needs either `wrench`, or `force` and `moment`, "
                f"but {'both are' if parts else 'neither is'} given."
            )
        if wrench is not None:
            self.wrench = require_row(f"`wrench` {where}", wrench, "(moment, fx, fy)")
        else:
            moment = _number(f"`moment` {where}", 0.0 if moment is None else moment)
            force = (0.0, 0.0) if force is None else force
            components = require_row(f"`force` {where}", force, "(fx, fy)", 2)
            self.wrench = jnp.concatenate([moment[None], components])
        self.at = require_row(f"`at` {where}", at, "(x, y)", 2)
        self.follower = follower


class Drive(eqx.Module):
    """A prescribed displacement of some coordinates of a body.

    The displacement is imposed exactly, and the reaction is returned with the solution.

    Args:
        body: Name of the body.
        angle: Rotation from the reference pose, if it is prescribed; rad.
        x: Displacement of the origin of the body along x, if it is prescribed; m.
        y: Displacement of the origin of the body along y, if it is prescribed; m.

    Raises:
        ValueError: No coordinate is given, or a value is not a finite number.

    Example:
        >>> Drive("input", x=1.35e-6, y=0.0).coordinates
        ('x', 'y')
    """

    body: str = eqx.field(static=True)
    angle: Scalar | None
    x: Scalar | None
    y: Scalar | None

    def __init__(
        self,
        body: str,
        *,
        angle: NumberLike | None = None,
        x: NumberLike | None = None,
        y: NumberLike | None = None,
    ):
        self.body = body
        values = dict(zip(COORDINATES, (angle, x, y), strict=True))
        if all(value is None for value in values.values()):
            raise ValueError(
                f"The drive of {body!r} prescribes no coordinate. Give `angle`, `x`, or "
                "`y`."
            )
        self.angle, self.x, self.y = (
            None
            if value is None
            else _number(f"`{name}` of the drive of {body!r}", value)
            for name, value in values.items()
        )

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the prescribed coordinates."""
        return tuple(name for name in COORDINATES if getattr(self, name) is not None)


class LoadSet(eqx.Module):
    """All loads on a mechanism, as functions of the displacements of its bodies.

    Args:
        bodies: Index of the body of each load.
        followers: Whether each load is a follower load.
        wrenches: Moment and force of each load; N m, N, N.
        at: Point of application of each load, in the frame of its body; m.
        angles: Angle of the body of each load in the reference configuration; rad.
    """

    bodies: tuple[int, ...] = eqx.field(static=True)
    followers: tuple[bool, ...] = eqx.field(static=True)
    wrenches: Float[Array, "loads 3"]
    at: Float[Array, "loads 2"]
    angles: Float[Array, " loads"]

    @classmethod
    def of(
        cls, loads: Sequence[Load], names: Sequence[str], reference: Poses
    ) -> "LoadSet":
        """Gather loads on bodies with given names and reference poses; rad, m, m."""
        bodies = tuple(names.index(load.body) for load in loads)
        count = len(bodies)
        return cls(
            bodies=bodies,
            followers=tuple(load.follower for load in loads),
            wrenches=jnp.array([load.wrench for load in loads]).reshape(count, 3),
            at=jnp.array([load.at for load in loads]).reshape(count, 2),
            angles=reference[np.array(bodies, int), 0],
        )

    @property
    def conservative(self) -> bool:
        """Whether the loads have a potential, which follower loads do not have."""
        return not any(self.followers)

    def apply(self, displacements: Poses) -> tuple[Wrenches, Wrenches]:
        """Compute the wrench that the loads apply to each body.

        Returns:
            The wrenches about the origins of the bodies, in world axes; N m, N, N. Their
            derivatives with respect to the angle of the body, the only coordinate on
            which they depend; N m/rad, N/rad, N/rad.
        """
        zero = jnp.zeros_like(displacements)
        if not self.bodies:
            return zero, zero
        bodies = np.array(self.bodies)
        angle = self.angles + displacements[bodies, 0]
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        followers = np.array(self.followers)
        moment, fx, fy = self.wrenches.T
        x = cos * self.at[:, 0] - sin * self.at[:, 1]
        y = sin * self.at[:, 0] + cos * self.at[:, 1]
        world_x = jnp.where(followers, cos * fx - sin * fy, fx)
        world_y = jnp.where(followers, sin * fx + cos * fy, fy)
        wrench = [moment + x * world_y - y * world_x, world_x, world_y]
        slope = [
            jnp.where(followers, 0.0, -x * fx - y * fy),
            jnp.where(followers, -world_y, 0.0),
            jnp.where(followers, world_x, 0.0),
        ]
        applied = zero.at[bodies].add(jnp.stack(wrench, axis=1))
        return applied, zero.at[bodies].add(jnp.stack(slope, axis=1))


def loaded_bodies(mechanism: Mechanism, loads: Sequence[Load]) -> tuple[int, ...]:
    """Find the index of the body of each load.

    Raises:
        ValueError: A name of a body is unknown, or an element is not a load.
    """
    require_kind("loads", loads, Load)
    return tuple(
        index_of(f"`loads[{k}]`", "body", load.body, mechanism.names)
        for k, load in enumerate(loads)
    )


def prescribed_dofs(
    mechanism: Mechanism, drives: Sequence[Drive]
) -> tuple[tuple[int, ...], tuple[Scalar, ...]]:
    """Find the prescribed degrees of freedom and their displacements.

    Returns:
        The indices of the degrees of freedom, three for each body, and the displacement
        of each; rad, m.

    Raises:
        ValueError: A name of a body is unknown, a coordinate is fixed or prescribed
            twice, or an element is not a drive.
    """
    require_kind("drives", drives, Drive)
    values: dict[int, Scalar] = {}
    for k, drive in enumerate(drives):
        body = index_of(f"`drives[{k}]`", "body", drive.body, mechanism.names)
        given = drive.angle, drive.x, drive.y
        for coordinate, (name, value) in enumerate(zip(COORDINATES, given, strict=True)):
            if value is None:
                continue
            dof = 3 * body + coordinate
            if dof in mechanism.fixed or dof in values:
                how = "fixed" if dof in mechanism.fixed else "prescribed"
                raise ValueError(
                    f"`drives[{k}]` prescribes the {name} of {drive.body!r}, which is "
                    f"{how} already."
                )
            values[dof] = value
    return tuple(values), tuple(values.values())


def _number(name: str, value: NumberLike) -> Scalar:
    """Convert a value to an array and check that it is one finite number."""
    number = concrete(value)
    if number is not None and not (
        number.shape == ()
        and np.issubdtype(number.dtype, np.number)
        and np.isfinite(number)
    ):
        raise ValueError(f"{name} is {value!r}, but must be a finite number.")
    return as_float(value)
