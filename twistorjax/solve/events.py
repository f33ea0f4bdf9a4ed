"""Events that end a motion."""

import diffrax as dfx
import equinox as eqx
import jax

from .._utils.types import Poses


class Snapshot(eqx.Module):
    """State of a motion, the argument of the condition of an event.

    Args:
        poses: Poses of the bodies; rad, m, m.
        displacements: Displacements of the bodies from their reference poses; rad, m, m.
        velocities: Velocities of the bodies; rad/s, m/s, m/s.
    """

    poses: Poses
    displacements: Poses
    velocities: Poses


def with_snapshots(event: dfx.Event) -> dfx.Event:
    """Convert an event whose conditions receive snapshots to one that receives states."""

    def wrapped(condition):
        def on_state(t, y, args, **more):
            displacements, velocities = args.expand(t, y.position, y.rate)
            poses = args.mechanism.reference + displacements
            return condition(t, Snapshot(poses, displacements, velocities), args, **more)

        return on_state

    conditions = jax.tree.map(wrapped, event.cond_fn, is_leaf=callable)
    return dfx.Event(conditions, event.root_finder, event.direction)
