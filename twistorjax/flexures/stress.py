"""The largest stress in a flexure, from its wrench or from its deformed state."""

import jax.numpy as jnp

from .._utils.types import BatchScalar, NumberLike, Scalar, WrenchLike
from .._utils.validation import require_positive, require_row
from .beam_solution import BeamSolution


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
    return jnp.max(jnp.abs(solution.stress), axis=(-2, -1))


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
    moment, axial, transverse = jnp.abs(
        require_row("`wrench`", wrench, "(moment, force 1, force 2)")
    )
    thickness = require_positive("`thickness`", thickness)
    width = require_positive("`width`", width)
    end_moment = moment + transverse * require_positive("`length`", length) / 2
    return 6 * end_moment / (width * thickness**2) + axial / (width * thickness)


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
    moment, axial, _ = jnp.abs(
        require_row("`wrench`", wrench, "(moment, force 1, force 2)")
    )
    web, width = require_positive("`web`", web), require_positive("`width`", width)
    bending, tension = _concentration_factors(web / require_positive("`hole`", hole))
    return bending * 6 * moment / (width * web**2) + tension * axial / (width * web)


def _concentration_factors(ratio: Scalar) -> tuple[Scalar, Scalar]:
    """Compute the stress concentration factors of a neck in bending and in tension.

    The ratio is half the thickness of the neck over the radius of its surface. A factor
    is the largest stress over that of a beam.
    """
    root = jnp.sqrt(ratio)
    angle = jnp.arctan(root)
    # The bending factor is a quotient of small differences for a thin neck, where its
    # series is used instead.
    thin = ratio < 1e-3
    safe = jnp.where(thin, 1.0, ratio)
    x = jnp.sqrt(safe)
    bending = 4 * safe * x / (3 * (x + (safe - 1) * jnp.arctan(x)))
    bending = jnp.where(thin, 1 + 2 / 5 * ratio - 17 / 175 * ratio**2, bending)
    tension = 2 * (ratio + 1) * root / ((ratio + 1) * angle + root)
    return bending, tension
