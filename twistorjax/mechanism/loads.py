"""The outside of a mechanism: what loads it and what drives it."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._utils.types import Point, Poses, Scalar, Wrench, Wrenches
from .._utils.validation import concrete, index_of, require_kind, require_row
from .mechanism import COORDINATES, Mechanism


class Load(eqx.Module):
    """A force and a moment on a body.

    Args:
        body: name of the body.
        wrench: moment and force, in world axes; N m, N, N.
        at: where on the body the force acts, in the body's frame; m.
        follower: whether the force turns with the body, so that `wrench` is in its axes
            (pressure, a thruster), or keeps its direction (weight, a taut string).

    Raises:
        ValueError: a shape is wrong or a value not finite.

    Example:
        >>> Load("stage", (0.0, 1.0, 0.0)).wrench  # 1 N along x
        Array([0., 1., 0.], dtype=float64)
    """

    body: str = eqx.field(static=True)
    wrench: Wrench
    at: Point
    follower: bool = eqx.field(static=True)

    def __init__(
        self,
        body: str,
        wrench: Float[ArrayLike, "3"] | Sequence[ArrayLike],
        at: Float[ArrayLike, "2"] | Sequence[ArrayLike] = (0.0, 0.0),
        *,
        follower: bool = False,
    ):
        self.body = body
        what = f"of the load on {body!r}"
        self.wrench = require_row(f"`wrench` {what}", wrench, "(moment, fx, fy)")
        self.at = require_row(f"`at` {what}", at, "(x, y)", 2)
        self.follower = follower


class Drive(eqx.Module):
    """A motion imposed on some coordinates of a body.

    Args:
        body: name of the body.
        angle: by which it is turned from rest, where that is imposed; rad.
        x: by which its origin is moved from rest along x, where that is imposed; m.
        y: the same along y; m.

    Raises:
        ValueError: no coordinate is given, or a value is not a finite number.

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
        angle: ArrayLike | None = None,
        x: ArrayLike | None = None,
        y: ArrayLike | None = None,
    ):
        self.body = body
        values = dict(zip(COORDINATES, (angle, x, y), strict=True))
        if all(value is None for value in values.values()):
            raise ValueError(
                f"The drive of {body!r} moves nothing: give it `angle`, `x` or `y`."
            )
        self.angle, self.x, self.y = (
            None
            if value is None
            else _number(f"`{name}` of the drive of {body!r}", value)
            for name, value in values.items()
        )

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates that are driven."""
        return tuple(name for name in COORDINATES if getattr(self, name) is not None)


class LoadSet(eqx.Module):
    """All loads on a mechanism, as functions of how far its bodies have moved.

    Args:
        bodies: the place of each load's body.
        follower: for each load, whether it turns with its body.
        wrenches: one a load; N m, N, N.
        at: one a load, in the body's frame; m.
        reference: angle of each load's body at rest; rad.
    """

    bodies: tuple[int, ...] = eqx.field(static=True)
    follower: tuple[bool, ...] = eqx.field(static=True)
    wrenches: Float[Array, "loads 3"]
    at: Float[Array, "loads 2"]
    reference: Float[Array, " loads"]

    @classmethod
    def of(
        cls, loads: Sequence[Load], bodies: tuple[int, ...], reference: Poses
    ) -> "LoadSet":
        """Gathers loads on the bodies of those places, which rest at those poses."""
        count = len(bodies)
        return cls(
            bodies=bodies,
            follower=tuple(load.follower for load in loads),
            wrenches=jnp.array([load.wrench for load in loads]).reshape(count, 3),
            at=jnp.array([load.at for load in loads]).reshape(count, 2),
            reference=reference[np.array(bodies, int), 0],
        )

    def apply(self, displacements: Poses) -> tuple[Wrenches, Wrenches]:
        """What the loads apply to each body at its origin, in world axes.

        Returns:
            The wrenches, and their derivatives by the angle of their own body, the only
            coordinate on which they depend.
        """
        none = jnp.zeros_like(displacements)
        if not self.bodies:
            return none, none
        bodies = np.array(self.bodies)
        angle = self.reference + displacements[bodies, 0]
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        follower = np.array(self.follower)
        moment, fx, fy = self.wrenches.T
        x, y = (
            cos * self.at[:, 0] - sin * self.at[:, 1],
            (sin * self.at[:, 0] + cos * self.at[:, 1]),
        )
        world_x = jnp.where(follower, cos * fx - sin * fy, fx)
        world_y = jnp.where(follower, sin * fx + cos * fy, fy)
        wrench = [moment + x * world_y - y * world_x, world_x, world_y]
        slope = [
            jnp.where(follower, 0.0, -x * fx - y * fy),
            jnp.where(follower, -world_y, 0.0),
            jnp.where(follower, world_x, 0.0),
        ]
        applied = none.at[bodies].add(jnp.stack(wrench, axis=1))
        return applied, none.at[bodies].add(jnp.stack(slope, axis=1))


def loaded_bodies(mechanism: Mechanism, loads: Sequence[Load]) -> tuple[int, ...]:
    """The place of each load's body.

    Raises:
        ValueError: a load names a body that the mechanism does not have, or is no load.
    """
    require_kind("loads", loads, Load)
    return tuple(
        index_of(f"`loads[{k}]`", "body", load.body, mechanism.names)
        for k, load in enumerate(loads)
    )


def driven(
    mechanism: Mechanism, drives: Sequence[Drive]
) -> tuple[tuple[int, ...], tuple[Scalar, ...]]:
    """The places of the driven coordinates, and the displacements they are given.

    Raises:
        ValueError: a drive names a body that the mechanism does not have, or a coordinate
            that is held or driven already.
    """
    require_kind("drives", drives, Drive)
    values: dict[int, Scalar] = {}
    for k, drive in enumerate(drives):
        body = index_of(f"`drives[{k}]`", "body", drive.body, mechanism.names)
        given = drive.angle, drive.x, drive.y
        for name, value in zip(COORDINATES, given, strict=True):
            if value is None:
                continue
            place = 3 * body + COORDINATES.index(name)
            if place in mechanism.fixed or place in values:
                how = "held" if place in mechanism.fixed else "driven"
                raise ValueError(
                    f"`drives[{k}]` drives the {name} of {drive.body!r}, which is {how} "
                    "already."
                )
            values[place] = value
    return tuple(values), tuple(values.values())


def _number(name: str, value: ArrayLike) -> Scalar:
    seen = concrete(value)
    if seen is not None and not (
        seen.shape == () and np.issubdtype(seen.dtype, np.number) and np.isfinite(seen)
    ):
        raise ValueError(f"{name} is {value!r}, but must be a finite number.")
    return jnp.asarray(value, float)
