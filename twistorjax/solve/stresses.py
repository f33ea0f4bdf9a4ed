"""Largest stress in each hinge of a mechanism, beside the strength of its material."""

import jax

from .._compile.compilation import fast_compile
from .._utils.progress import announced
from .._utils.types import PosesOrResult
from ..assembly.stress import largest_stresses, rows_with_stress
from ..mechanism.mechanism import Mechanism
from .equations.stresses import select_stresses, Stresses


@announced("stresses")
def stresses(mechanism: Mechanism, at: PosesOrResult) -> Stresses:
    """Compute the largest stress in each hinge of a mechanism.

    The dimensions of a hinge are known if its energy was created by `flexures.leaf`,
    `flexures.notch`, another function of `flexures`, or `surrogate` of a `Beam` or of a
    sub-mechanism of such hinges. The stress in a leaf or a notch is that of linear
    bending and tension under the wrench of the hinge. The stress in a surrogate is that
    in the cross-sections of the deformed beam, or the largest one of the hinges of the
    sub-mechanism. Only `flexures.notch` includes the stress concentration at the curved
    surface.
    At fillets and sharp corners, and in necks that are as thick as long, the largest
    stress needs finite elements.

    Args:
        mechanism: The mechanism.
        at: Equilibrium, path, or motion of this mechanism, or poses of its bodies; rad,
            m, m.

    Returns:
        The stresses, with an axis in front for the points of a path, the times of a
        motion, or a batch of equilibria. They are differentiable.

    Raises:
        ValueError: The dimensions of no hinge are known, or the poses are not those of
            the bodies.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3, strength=400e6)
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> hinge = tj.Hinge("leaf", "wall", "block", leaf, at=(0, 0, 0))
        >>> bodies = [tj.Body("wall"), tj.Body("block")]
        >>> mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        >>> pushed = tj.equilibrium(mechanism, loads=[tj.Load("block", moment=0.05)])
        >>> stresses(mechanism, pushed)
        hinge  stress (MPa)  of the strength
        leaf            120              0.3
    """
    rows = rows_with_stress(mechanism.hinge_assembly)
    if not rows:
        raise ValueError(
            "The stress is not known in any hinge. Create the energies from dimensions, "
            "by `flexures.leaf`, `flexures.notch`, or `surrogate` of a `flexures.Beam`."
        )
    largest = mechanism.of_hinges(at, _largest)
    return select_stresses(mechanism.hinge_assembly, largest, mechanism.hinge_names)


_largest = fast_compile(largest_stresses, jit=jax.jit)
