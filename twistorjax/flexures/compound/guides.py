"""Ready-made flexures that are compliant in one translation.

They are sub-mechanisms of equal leaves, to be used as one hinge: `Condensed` is their
exact energy, and `surrogate` computes a fast one. The leaves are parallel to axis 1, and
the flexures are compliant along axis 2. The frame is at the center.
"""

import numpy as np

from ..._utils.types import NumberLike, Scalar
from ..._utils.validation import require_interval, require_positive
from ...energies.base import AbstractEnergy
from ...mechanism.body import Body
from ...mechanism.sub_mechanism import SubMechanism
from ..beams.beam import Beam
from .leaves import assemble, box, FIRST, Leaf, require_leaf, SECOND


def parallelogram(
    beam: Beam, energy: AbstractEnergy, *, spacing: NumberLike
) -> SubMechanism:
    """Create a translational flexure of two parallel leaves from body A to body B.

    Its transverse stiffness without a load is `24 E I / L^3`.

    Args:
        beam: A leaf; it gives the length and the outline.
        energy: Energy of a leaf, such as `surrogate(beam, rotation=0.2)`.
        spacing: Distance between the leaves; m.

    Returns:
        The flexure. Its leaves are "leaf 1" and "leaf 2".

    Raises:
        ValueError: The beam is curved, or the spacing is not positive.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> beam = Beam(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> guide = parallelogram(beam, leaf, spacing=30e-3)
        >>> tj.flexures.Condensed(guide).tangent_stiffness()[2, 2]
        Array(4200., dtype=float64)
    """
    require_leaf(beam, energy)
    half = require_positive("`spacing`", spacing) / 2
    start = -beam.length / 2
    leaves = [Leaf(FIRST, SECOND, (0.0, side * half), 0.0, start) for side in (1, -1)]
    return assemble(beam, energy, leaves)


def double_parallelogram(
    beam: Beam,
    energy: AbstractEnergy,
    *,
    outer_spacing: NumberLike,
    inner_spacing: NumberLike,
) -> SubMechanism:
    """Create a translational flexure of two parallelograms in series.

    Body A is connected to the inner body by the two outer leaves, and this one to body B
    by the two inner leaves, which are next to them. The shortenings of both pairs
    compensate each other, so that body B moves nearly straight. The transverse stiffness
    is `12 E I / L^3`. The inner body has no support of its own, so the axial stiffness
    decreases with the displacement.

    Args:
        beam: A leaf; it gives the length and the outline.
        energy: Energy of a leaf, such as `surrogate(beam, rotation=0.2)`.
        outer_spacing: Distance between the leaves on body A; m.
        inner_spacing: Distance between the leaves on body B; m.

    Returns:
        The flexure. Its leaves are "leaf 1" to "leaf 4", and its inner body is "middle".

    Raises:
        ValueError: The beam is curved, a spacing is not positive, or the inner spacing is
            not smaller than the outer one.

    Source:
        Awtar, Slocum and Sevincer, Characteristics of beam-based flexure modules, J.
        Mech. Des. 129, 2007.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> beam = Beam(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> guide = double_parallelogram(
        ...     beam, leaf, outer_spacing=40e-3, inner_spacing=20e-3
        ... )
        >>> tj.flexures.Condensed(guide).tangent_stiffness()[2, 2]
        Array(2100., dtype=float64)
    """
    require_leaf(beam, energy)
    outer = require_positive("`outer_spacing`", outer_spacing) / 2
    inner = _inner_half(outer, "inner_spacing", inner_spacing)
    half = beam.length / 2
    leaves = [Leaf(FIRST, "middle", (0.0, side * outer), 0.0, -half) for side in (1, -1)]
    leaves += [
        Leaf(SECOND, "middle", (0.0, side * inner), 0.0, -half) for side in (1, -1)
    ]
    thickness = beam.length / 10
    middle = Body(
        "middle", (0.0, half + thickness / 2, 0.0), outline=box(thickness, 2.2 * outer)
    )
    return assemble(beam, energy, leaves, [middle])


def folded_beam(
    beam: Beam,
    energy: AbstractEnergy,
    *,
    outer_spacing: NumberLike,
    inner_spacing: NumberLike,
    gap: NumberLike,
) -> SubMechanism:
    """Create a folded-beam suspension, as of many micromechanical resonators.

    On either side of the center, the two inner leaves connect body A, the anchor, to a
    truss, and the two outer leaves connect the truss to body B, the shuttle. It is two
    double parallelograms that are mirror images of each other. The transverse stiffness
    is `24 E I / L^3`.

    Args:
        beam: A leaf; it gives the length and the outline.
        energy: Energy of a leaf, such as `surrogate(beam, rotation=0.2)`.
        outer_spacing: Distance between the leaves on body B; m.
        inner_spacing: Distance between the leaves on body A; m.
        gap: Distance between the leaves of both sides along axis 1; m.

    Returns:
        The flexure. Its leaves are "leaf 1" to "leaf 8", and its inner bodies are
        "right" and "left".

    Raises:
        ValueError: The beam is curved, a spacing is not positive, the inner spacing is
            not smaller than the outer one, or the gap is negative.

    Source:
        Tang, Nguyen and Howe, Laterally driven polysilicon resonant microstructures,
        Sensors and Actuators 20, 1989.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> beam = Beam(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> guide = folded_beam(
        ...     beam, leaf, outer_spacing=40e-3, inner_spacing=20e-3, gap=10e-3
        ... )
        >>> tj.flexures.Condensed(guide).tangent_stiffness()[2, 2]
        Array(4200., dtype=float64)
    """
    require_leaf(beam, energy)
    outer = require_positive("`outer_spacing`", outer_spacing) / 2
    inner = _inner_half(outer, "inner_spacing", inner_spacing)
    start = require_interval("`gap`", gap, -1e-12, np.inf, "must not be negative") / 2
    thickness = beam.length / 10
    leaves, trusses = [], []
    for angle, sign, truss in ((0.0, 1, "right"), (np.pi, -1, "left")):
        for body, half in ((FIRST, inner), (SECOND, outer)):
            leaves += [
                Leaf(body, truss, (0.0, side * half), angle, start) for side in (1, -1)
            ]
        center = sign * (start + beam.length + thickness / 2)
        outline = box(thickness, 2.2 * outer)
        trusses.append(Body(truss, (0.0, center, 0.0), outline=outline))
    return assemble(beam, energy, leaves, trusses)


def _inner_half(outer: Scalar, name: str, spacing: NumberLike) -> Scalar:
    """Check the spacing of inner leaves, and return half of it; m."""
    half = require_positive(f"`{name}`", spacing) / 2
    require_interval(
        f"`{name} / outer_spacing`", half / outer, 0.0, 1.0, "must be below 1"
    )
    return half
