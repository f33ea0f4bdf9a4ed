"""What is wrong with a motion that cannot begin, or that did not reach its end."""

from collections.abc import Sequence
from typing import Any, cast, TYPE_CHECKING

import jax
import numpy as np
from jaxtyping import Array

from .._utils.types import Poses
from .._utils.validation import all_concrete
from ..mechanism.constraints import ConstraintSet
from ..mechanism.loads import Drive, driven
from ..mechanism.mechanism import Mechanism
from .initial_state import EXACT
from .results import result_message
from .statics import free_coordinates


if TYPE_CHECKING:
    from .motion import Motion


def _length(mechanism: Mechanism) -> float:
    """The length of a lever, where values can be seen; see `_scales`."""
    free = free_coordinates(len(mechanism.names), mechanism.fixed, ())
    return float(mechanism.hinge_assembly.lever(free)) or 1.0


def _given(drives: Any, now: Array) -> Sequence[Drive]:
    return cast(Sequence[Drive], drives(now) if callable(drives) else drives)


def refuse(
    mechanism: Mechanism,
    drives,
    joints: ConstraintSet,
    moved: Poses,
    now: Array,
    told: bool,
) -> None:
    """Refuses a start that can be seen to be none, before anything is compiled."""
    if all_concrete([moved, now, *jax.tree.leaves((mechanism, joints))]) is None:
        return
    given = _given(drives, now)
    places, targets = driven(mechanism, given)
    if all_concrete(targets) is None:
        return
    unit = _length(mechanism)
    for place, target in zip(places, targets, strict=True):
        apart = abs(float(target) - float(moved.reshape(-1)[place]))
        if apart > EXACT * (1.0 if place % 3 == 0 else unit):
            words = _jumps(mechanism, drives, moved, now)
            raise ValueError(f"{result_message('drive_jumps')} {words}")
    seen = np.isfinite(np.asarray(joints.violation(moved, now))) if joints.size else ()
    if joints.size and not told and np.all(seen):
        words = _at_odds(mechanism, joints, moved, now, drives)
        if not words.startswith("The velocities"):
            raise ValueError(f"{result_message('inconsistent_constraints')} {words}")


def failure(
    answer: "Motion",
    mechanism: Mechanism,
    drives,
    joints: ConstraintSet,
    moved: Poses,
    now: Array,
    item: str,
    batch_index: tuple[int, ...],
) -> Exception:
    """What is wrong with a motion that did not reach its end, or could not begin."""
    text = result_message(item)
    if batch_index:
        return RuntimeError(
            f"{text} (lane {', '.join(map(str, batch_index))} of the batch)"
        )
    if item == "drive_jumps":
        return ValueError(f"{text} {_jumps(mechanism, drives, moved, now)}")
    if item == "inconsistent_constraints":
        return ValueError(f"{text} {_at_odds(mechanism, joints, moved, now, drives)}")
    if item in ("times_not_increasing", "damping_gives_energy"):
        return ValueError(text)
    if item == "not_finite":
        text += _not_finite(mechanism)
    return RuntimeError(f"{text} {_stopped(answer, mechanism)}")


def _jumps(mechanism: Mechanism, drives, moved: Poses, now: Array) -> str:
    given = _given(drives, now)
    places, targets = driven(mechanism, given)
    words = [
        f"The {mechanism.coordinate(place)} starts at {moved.reshape(-1)[place]:.6g} and "
        f"is driven to {target:.6g}."
        for place, target in zip(places, targets, strict=True)
        if abs(float(target) - float(moved.reshape(-1)[place])) > 0
    ]
    return " ".join(words)


def _at_odds(
    mechanism: Mechanism, joints: ConstraintSet, moved: Poses, now: Array, drives
) -> str:
    """Which constraints are violated at the start, or add nothing to those before."""
    given = _given(drives, now)
    places, _ = driven(mechanism, given)
    free = free_coordinates(len(mechanism.names), mechanism.fixed, places)
    violation = np.asarray(joints.violation(moved, now))
    normals = np.asarray(
        jax.jacrev(lambda moved: joints.violation(moved, now))(moved)
    ).reshape(violation.size, -1)[:, list(free)]
    normals = normals * np.where(np.array(free) % 3 == 0, 1.0, _length(mechanism))
    size = np.linalg.norm(normals, axis=1)
    size = np.where(size > 0, size, 1.0)
    normals, share = normals / size[:, None], np.abs(violation) / size
    owners = joints.owners()
    words = []
    for name in dict.fromkeys(owners):
        own = [k for k, owner in enumerate(owners) if owner == name]
        before = own[0]
        rank = np.linalg.matrix_rank(normals[:before], 1e-9) if before else 0
        gained = np.linalg.matrix_rank(normals[: own[-1] + 1], 1e-9) - rank
        worst, violated = np.abs(violation[own]).max(), share[own].max() > EXACT
        if gained < len(own) and violated:
            words.append(
                f"{name!r} contradicts those before it: it leaves {worst:.3g} that "
                "nothing can mend."
            )
        elif gained < len(own):
            words.append(
                f"{name!r} is redundant: {len(own) - gained} of its {len(own)} entries "
                "follow from those before it and from what is held or driven. Leave it "
                "out."
            )
        elif violated:
            words.append(f"{name!r} is violated by {worst:.3g} at the start.")
    return " ".join(words) or "The velocities at the start are against them."


def _not_finite(mechanism: Mechanism) -> str:
    """Which hinge or body has the value."""
    for place, name in enumerate(mechanism.hinge_names):
        values = jax.tree.leaves(mechanism.hinge_assembly.energy_of(place))
        if not all(np.all(np.isfinite(value)) for value in values):
            return f" It is in the energy of the hinge {name!r}."
    for body, name in enumerate(mechanism.names):
        values = (
            mechanism.reference[body],
            mechanism.masses[body],
            mechanism.inertias[body],
        )
        if not all(np.all(np.isfinite(v)) for v in values if v is not None):
            return f" It is in the body {name!r}."
    return ""


def _stopped(answer: "Motion", mechanism: Mechanism) -> str:
    """When, and who moved fastest and bore most in what was kept."""
    at = f"It went to t = {float(answer.reached):.6g} s in {int(answer.steps)} steps."
    kept = np.flatnonzero(np.isfinite(np.asarray(answer.times)))
    if not kept.size:
        return at
    last = kept[-1]
    if last == 0:
        return at
    fastest = np.argmax(
        np.linalg.norm(np.asarray(answer.velocities)[last, :, 1:], axis=1)
    )
    poses = answer.poses[last]
    stored = [
        float(
            mechanism.hinge_assembly.energy_of(place)(
                mechanism.displacement_of(name, poses)
            )
        )
        for place, name in enumerate(mechanism.hinge_names)
    ]
    return (
        f"{at} At {float(answer.times[last]):.6g} s the body "
        f"{mechanism.names[fastest]!r} moved fastest, and the hinge "
        f"{mechanism.hinge_names[int(np.argmax(stored))]!r} stored most."
    )
