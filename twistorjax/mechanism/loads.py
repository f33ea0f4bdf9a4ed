"""Loads on the bodies of a mechanism, and prescribed displacements."""

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._utils.host import as_float, concrete, on_host
from .._utils.printing import Printed
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
from .._utils.validation import (
    index_of,
    quote,
    require_instance,
    require_kind,
    require_row,
    warn_if_degrees,
    warn_if_long,
)
from .mechanism import COORDINATES, Mechanism


_LONGEST_DRIVE = 1.5  # which must be given in meters; m


class Load(Printed):
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
        where = f"of the load on {quote(body)}"
        parts = force is not None or moment is not None
        if (wrench is None) != parts:
            raise ValueError(
                f"The load on {quote(body)} needs either `wrench`, or `force` and "
                f"`moment`, but {'both are' if parts else 'neither is'} given."
            )
        if wrench is not None:
            self.wrench = require_row(f"`wrench` {where}", wrench, "(moment, fx, fy)")
        else:
            moment = _number(f"`moment` {where}", 0.0 if moment is None else moment)
            force = (0.0, 0.0) if force is None else force
            components = require_row(f"`force` {where}", force, "(fx, fy)", 2)
            numpy, (moment, components) = on_host(moment, components)
            self.wrench = as_float(numpy.append(moment, components))
        self.at = require_row(f"`at` {where}", at, "(x, y)", 2)
        self.follower = follower


class Drive(Printed):
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
                f"The drive of {quote(body)} prescribes no coordinate. Give `angle`, "
                "`x`, or `y`."
            )
        self.angle, self.x, self.y = (
            None
            if value is None
            else _number(f"`{name}` of the drive of {quote(body)}", value)
            for name, value in values.items()
        )
        if self.angle is not None:
            warn_if_degrees(f"`angle` of the drive of {body!r}", self.angle)
        for name, value in (("x", self.x), ("y", self.y)):
            if value is not None:
                owner = f"`{name}` of the drive of {body!r}"
                warn_if_long(owner, value, _LONGEST_DRIVE, "a mechanism")

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the prescribed coordinates."""
        return tuple(name for name in COORDINATES if getattr(self, name) is not None)


def weights(
    mechanism: Mechanism, gravity: ForceLike = (0.0, -9.80665)
) -> tuple[Load, ...]:
    """Compute the weights of all bodies that can move.

    Args:
        mechanism: The mechanism. The origin of the frame of a body must be its center of
            mass.
        gravity: Acceleration along x and along y, or another force per mass; m/s^2.

    Returns:
        A load on each body that can move.

    Raises:
        ValueError: A body that can move has no mass, or a shape is wrong.

    Example:
        >>> from twistorjax import Body, Hinge, Quadratic
        >>> spring = Quadratic(jnp.diag(jnp.array([1.0, 100.0, 10.0])))
        >>> hinge = Hinge("spring", "wall", "block", spring, at=(0, 0, 0))
        >>> bodies = [Body("wall"), Body("block", mass=2.0)]
        >>> weights(Mechanism(bodies, [hinge], fixed=["wall"]))[0].wrench
        Array([  0.    ,   0.    , -19.6133], dtype=float64)
    """
    field = require_row("`gravity`", gravity, "(along x, along y)", 2)
    require_instance("mechanism", mechanism, Mechanism)
    loads = []
    for body, (name, mass) in enumerate(
        zip(mechanism.names, mechanism.masses, strict=True)
    ):
        if mechanism.is_fixed(body):
            continue
        if mass is None:
            raise ValueError(
                f"The body {name!r} can move, but has no `mass`, and thus no weight."
            )
        _, (of_body, acceleration) = on_host(mass, field)
        loads.append(Load(name, force=as_float(of_body * acceleration)))
    return tuple(loads)


class LoadSet(eqx.Module):
    """The sum of the loads on each body, as a function of its rotation.

    The array does not depend on the number of loads and on the bodies to which they are
    applied, so that other loads need no other compiled program.
    """

    # Seven sums for each body, in the reference configuration and world axes. The moments
    # about its origin that do not depend on its rotation; N m. The forces of constant
    # direction; N, N. The cross products, and the scalar products, of arms and these
    # forces, which determine their moment; N m, N m. The forces that rotate with the
    # body; N, N.
    sums: Float[Array | np.ndarray, "bodies 7"]
    present: bool = eqx.field(static=True)  # Whether there is a load
    # Whether the loads have a potential, which follower loads do not have
    conservative: bool = eqx.field(static=True)

    @classmethod
    def of(cls, mechanism: Mechanism, loads: Sequence[Load]) -> "LoadSet":
        """Sum up the loads on each body of a mechanism."""
        bodies, count = np.array(loaded_bodies(mechanism, loads)), len(mechanism.names)
        if not loads:
            return _zero(count, present=False, conservative=True)
        followers = np.array([load.follower for load in loads])
        actions = [value for load in loads for value in (load.wrench, load.at)]
        xp, (poses, *actions) = on_host(mechanism.reference, *actions)
        add = partial(_load_sums, np) if xp is np else _traced_load_sums
        sums = add(poses, actions, bodies, followers)
        return cls(sums, present=True, conservative=not followers.any())

    def require_potential(self, instead: str) -> None:
        """Refuse follower loads, and recommend what to use `instead`."""
        if not self.conservative:
            raise ValueError(
                "There is a follower load. It has no potential, so the stiffness is not "
                f"symmetric: use {instead}."
            )

    def zero(self) -> "LoadSet":
        """Return loads of zero of the same kind."""
        return _zero(self.sums.shape[0], self.present, self.conservative)

    def scaled(self, factor: Scalar | float) -> "LoadSet":
        return LoadSet(factor * jnp.asarray(self.sums), self.present, self.conservative)

    def plus(self, others: "LoadSet") -> "LoadSet":
        _, (sums, more) = on_host(self.sums, others.sums)
        return LoadSet(
            sums + more,
            present=self.present or others.present,
            conservative=self.conservative and others.conservative,
        )

    def apply(self, displacements: Poses) -> tuple[Wrenches, Wrenches]:
        """Compute the wrench of the loads on each body, and its derivative.

        The wrenches are about the origins of the bodies, in world axes (N m, N, N). They
        depend on the angle of the body only (N m/rad, N/rad, N/rad).
        """
        zero = jnp.zeros_like(displacements)
        if not self.present:
            return zero, zero
        cos, sin = jnp.cos(displacements[:, 0]), jnp.sin(displacements[:, 0])
        sums = jnp.asarray(self.sums)
        cross, dot, follower_x, follower_y = sums[:, 3:].T
        applied = sums[:, :3].at[:, 0].add(cos * cross - sin * dot)
        slope = zero.at[:, 0].set(-sin * cross - cos * dot)
        if self.conservative:
            return applied, slope
        x = cos * follower_x - sin * follower_y
        y = sin * follower_x + cos * follower_y
        applied = applied + jnp.stack([zero[:, 0], x, y], axis=1)
        return applied, slope + jnp.stack([zero[:, 0], -y, x], axis=1)

    def work(self, displacements: Poses) -> Scalar:
        """Compute the work of loads with a potential, from the reference poses; J."""
        angle, x, y = displacements.T
        moment, fx, fy, cross, dot = jnp.asarray(self.sums).T[:5]
        turned = jnp.sin(angle) * cross + (jnp.cos(angle) - 1) * dot
        return jnp.sum(moment * angle + fx * x + fy * y + turned)


def _load_sums(
    xp: Any,
    poses: Any,
    actions: Sequence[Any],
    bodies: Int[Array | np.ndarray, " loads"],
    followers: Bool[Array | np.ndarray, " loads"],
) -> Any:
    """Compute the sums of a `LoadSet` by `numpy` or `jax.numpy`.

    The action of a load is its wrench and point of application; N m, N, N, m, m.
    """
    moment, fx, fy = xp.stack(actions[::2], axis=1)
    x, y = xp.stack(actions[1::2], axis=1)
    cos, sin = xp.cos(poses[bodies, 0]), xp.sin(poses[bodies, 0])
    zero, turned_x, turned_y = 0 * fx, cos * fx - sin * fy, sin * fx + cos * fy
    of_followers = [moment + x * fy - y * fx, *4 * (zero,), turned_x, turned_y]
    x, y = cos * x - sin * y, sin * x + cos * y
    others = [moment, fx, fy, x * fy - y * fx, x * fx + y * fy, zero, zero]
    of_loads = xp.where(
        followers[:, None], xp.stack(of_followers, axis=1), xp.stack(others, axis=1)
    )
    chosen = np.arange(len(poses))[:, None, None] == bodies[None, :, None]
    return xp.sum(xp.where(chosen, of_loads[None], 0.0), axis=1)


# In a gradient outside of `jax.jit`, each operation would be a program.
_traced_load_sums = jax.jit(partial(_load_sums, jnp))


@lru_cache
def _zero(bodies: int, present: bool, conservative: bool) -> LoadSet:
    """Create loads of zero on so many bodies; see `LoadSet`."""
    return LoadSet(np.zeros((bodies, 7)), present, conservative)


def loaded_bodies(mechanism: Mechanism, loads: Sequence[Load]) -> tuple[int, ...]:
    """Find the index of the body of each load."""
    require_kind("loads", loads, Load)
    return tuple(
        index_of(f"`loads[{k}]`", "body", load.body, mechanism.names)
        for k, load in enumerate(loads)
    )


def prescribed_dofs(
    mechanism: Mechanism, drives: Sequence[Drive]
) -> tuple[tuple[int, ...], tuple[Scalar, ...]]:
    """Find the prescribed degrees of freedom and their displacements; rad, m.

    There are three degrees of freedom for each body.
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
                how = "prescribed already. Give each coordinate once."
                if dof in mechanism.fixed:
                    how = (
                        "fixed already. Leave it out of `fixed` of the mechanism, which "
                        f"may be a mapping such as {{{drive.body!r}: ['angle']}}."
                    )
                raise ValueError(
                    f"`drives[{k}]` prescribes the {name} of {drive.body!r}, which is "
                    f"{how}"
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
        raise ValueError(f"{name} is {quote(value)}, but must be a finite number.")
    return as_float(value)
