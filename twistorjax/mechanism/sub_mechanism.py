"""A mechanism that acts as one hinge between two of its bodies."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from .._utils.types import Pose, PoseLike
from .._utils.validation import index_of, require_instance, require_pose
from ..energies.base import AbstractEnergy
from ..energies.validity import without_ranges
from ..geometry import se2
from .body import Body
from .hinge import AbstractOutline, Hinge
from .mechanism import Mechanism


class SubMechanism(AbstractOutline):
    """A mechanism that is used as one hinge between two of its bodies.

    Body A is the one that is fixed. Frame a on body A and frame b on body B coincide in
    the reference configuration. The other bodies are inner bodies, on which no loads act.
    Masses, damping, and expansions of its bodies and hinges are not used.
    `flexures.Condensed` is the exact energy of the sub-mechanism, and
    `flexures.surrogate` computes a fast one. Give the sub-mechanism as the `outline` of
    the hinge, and its leaves and inner bodies are drawn.

    Args:
        mechanism: The mechanism. One body is fixed, and its hinges have no misfits.
        second: Name of body B.
        at: Pose of frames a and b in the reference configuration; by default that of
            body B; rad, m, m. For a surrogate, axis 2 is the compliant direction of a
            translational flexure.

    Raises:
        ValueError: Not exactly one body is fixed, body B is unknown or fixed, a hinge has
            a misfit, or the pose is invalid.

    Example:
        >>> import numpy as np
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> pivot = tj.SubMechanism(
        ...     tj.Mechanism(
        ...         [tj.Body("lower"), tj.Body("upper")],
        ...         [
        ...             tj.Hinge("left", "lower", "upper", leaf, at=(np.pi / 4, 0, 0)),
        ...             tj.Hinge("right", "lower", "upper", leaf, at=(-np.pi / 4, 0, 0)),
        ...         ],
        ...         fixed=["lower"],
        ...     ),
        ...     "upper",
        ... )
        >>> tj.flexures.Condensed(pivot).tangent_stiffness()[0, 0]
        Array(0.875, dtype=float64)
    """

    mechanism: Mechanism
    second: str = eqx.field(static=True)

    def __init__(self, mechanism: Mechanism, second: str, at: PoseLike | None = None):
        require_instance("mechanism", mechanism, Mechanism)
        fixed = [name for k, name in enumerate(mechanism.names) if mechanism.is_fixed(k)]
        if len(fixed) != 1 or len(mechanism.fixed) != 3:
            raise ValueError(
                f"A sub-mechanism needs one fixed body, which is body A, but in this one "
                f"{', '.join(map(repr, fixed)) or 'no body'} and "
                f"{len(mechanism.fixed) - 3 * len(fixed)} other coordinates are fixed."
            )
        row = index_of("`second`", "body", second, mechanism.names)
        if second == fixed[0]:
            raise ValueError(
                f"`second` is {second!r}, which is the fixed body. Give the other one."
            )
        if mechanism.hinge_assembly.misfits is not None:
            raise ValueError(
                "A hinge of the sub-mechanism has a misfit, but a sub-mechanism must not "
                "be loaded in its reference configuration. Give the hinge that replaces "
                "the sub-mechanism a misfit."
            )
        frame = mechanism.reference[row] if at is None else require_pose("`at`", at)
        self.mechanism = _in_frame(mechanism, second, frame, lambda energy: energy)
        self.second = second

    def without_ranges(self) -> Mechanism:
        """Return its mechanism without the validity ranges of the hinges."""
        origin = jnp.zeros(3)
        return _in_frame(self.mechanism, self.second, origin, without_ranges)

    @property
    def first(self) -> str:
        """Name of body A."""
        return self.mechanism.names[self.mechanism.fixed[0] // 3]

    def __repr__(self) -> str:
        names, hinges = self.mechanism.names, self.mechanism.hinge_names
        return (
            f"SubMechanism of {len(names)} bodies ({', '.join(names)}) and {len(hinges)} "
            f"hinges, from {self.first} to {self.second}"
        )


def _in_frame(
    mechanism: Mechanism,
    second: str,
    frame: Pose,
    change: Callable[[AbstractEnergy], AbstractEnergy],
) -> Mechanism:
    """Express a mechanism in a frame (rad, m, m), which becomes that of body B.

    The frame of body A is that of the world. The energies of the hinges are changed.
    """
    to_frame = se2.inverse(frame)
    origin = (0.0, 0.0, 0.0)
    bodies = []
    for row, name in enumerate(mechanism.names):
        if name == second or mechanism.is_fixed(row):
            bodies.append(Body(name, origin))  # The outer mechanism draws it.
            continue
        pose = se2.compose(to_frame, mechanism.reference[row])
        bodies.append(Body(name, pose, outline=mechanism.outlines[row]))
    hinges = [
        Hinge(
            name,
            mechanism.names[first],
            mechanism.names[second_row],
            change(mechanism.hinge_assembly.energy_of(row)),
            se2.compose(to_frame, mechanism.at[row]),
            outline=mechanism.hinge_outlines[row],
        )
        for row, (name, (first, second_row)) in enumerate(
            zip(mechanism.hinge_names, mechanism.hinge_assembly.ends, strict=True)
        )
    ]
    return Mechanism(bodies, hinges, fixed=[mechanism.names[mechanism.fixed[0] // 3]])
