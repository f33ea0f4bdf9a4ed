"""The largest stress in a flexure, from its wrench or from its deformed state."""

import jax.numpy as jnp

from ..._utils.pytrees import largest_of
from ..._utils.types import BatchScalar, NumberLike, Scalar, WrenchLike
from ..._utils.validation import require_length, require_row
from ...energies.stress_model import Strengths
from ...geometry.twistors import Displacement
from .stress_models import SectionStress
from .under_load import BeamSolution


def largest_stress(solution: BeamSolution) -> BatchScalar:
    """Compute the largest magnitude of the stress in a deformed beam.

    The field `stress` of the solution is signed, so its maximum is the largest tension.
    The compression may be larger in magnitude, as in the example. A notch or a leaf with
    fillets under a transverse force needs a solution with about 201 cross-sections, which
    is the default, because its most stressed section is neither in the middle nor at an
    end. Like `stress`, the result does not include the stress concentration at notches,
    fillets or sharp corners.

    Args:
        solution: Deformed state of a beam, or a batch of them.

    Returns:
        The largest magnitude, in tension or in compression, over all cross-sections of
        the solution; Pa. It has an entry for each state of a batch.

    Example:
        >>> import twistorjax as tj
        >>> polymer = tj.Material(modulus=3.45e9, poisson=0.3)
        >>> beam = tj.flexures.Beam(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> moment, axial_force = 0.01, -20.0  # N m, N
        >>> load = jnp.array([moment, axial_force, 0.0])
        >>> solution = tj.flexures.beam_under_load(beam, load)
        >>> solution.stress.max() / 1e6  # largest tension; MPa
        Array(8., dtype=float64)
        >>> largest_stress(solution) / 1e6  # largest magnitude, here in compression; MPa
        Array(16., dtype=float64)
    """
    return largest_of(jnp.abs(solution.stress).reshape(*solution.stress.shape[:-2], -1))


def leaf_stress(
    wrench: WrenchLike,
    *,
    length: NumberLike,
    thickness: NumberLike,
    width: NumberLike,
) -> Scalar:
    """Compute the largest stress along a leaf, at the surface of one of its ends.

    It is the stress of a straight beam, without the stress concentration at fillets or
    sharp corners. For large rotations use `beam_at_pose` and `largest_stress`.

    Args:
        wrench: Wrench on the leaf about its middle, as `Mechanism.wrench_of` returns it;
            N m, N, N.
        length: Free length; m.
        thickness: In-plane thickness; m.
        width: Out-of-plane width; m.

    Returns:
        The largest magnitude of the stress, in tension or in compression; Pa. It is never
        negative.

    Raises:
        ValueError: A dimension is not positive, or a shape is wrong.

    Example:
        >>> transverse_force = 1.0  # N
        >>> wrench = (0.0, 0.0, transverse_force)
        >>> leaf_stress(wrench, length=10e-3, thickness=1e-3, width=5e-3)
        Array(6000000., dtype=float64)
    """
    model = SectionStress.of_leaf(
        Strengths(),
        require_length("`length`", length),
        require_length("`thickness`", thickness),
        require_length("`width`", width),
    )
    return _largest(model, wrench)


def notch_stress(
    wrench: WrenchLike,
    *,
    hole: NumberLike,
    web: NumberLike,
    width: NumberLike,
) -> Scalar:
    """Compute the largest stress in the neck of a notch, at its thinnest section.

    It is the stress of a beam with this section, times the stress concentration factor of
    the curved surface. For a web of a twelfth of the hole the factor is 1.03 in bending
    and 1.05 in tension.

    Args:
        wrench: Wrench on the notch about its middle, as `Mechanism.wrench_of` returns it;
            N m, N, N.
        hole: Diameter of the two circular holes; m.
        web: Smallest thickness of the neck; m.
        width: Out-of-plane width; m.

    Returns:
        The largest magnitude of the stress, in tension or in compression; Pa. It is never
        negative.

    Raises:
        ValueError: A dimension is not positive, or a shape is wrong.

    Source:
        Stress concentration factors of deep hyperbolic notches: Neuber,
        Kerbspannungslehre (1937), with the radius of the hole.

    Example:
        >>> moment = 0.01  # N m
        >>> notch_stress((moment, 0.0, 0.0), hole=3e-3, web=0.25e-3, width=0.02)
        Array(49568906.12688149, dtype=float64)
    """
    model = SectionStress.of_notch(
        Strengths(),
        require_length("`hole`", hole),
        require_length("`web`", web),
        require_length("`width`", width),
    )
    return _largest(model, wrench)


def _largest(model: SectionStress, wrench: WrenchLike) -> Scalar:
    """Compute the largest magnitude of the stress under a wrench (N m, N, N); Pa."""
    values = require_row("`wrench`", wrench, "(moment, force 1, force 2)")
    moment, axial, transverse = values
    displacement = Displacement.from_pose(jnp.zeros(3))
    stresses = model.surface_stresses(displacement, (moment, axial, transverse))
    return largest_of(jnp.abs(stresses).reshape(-1))
