"""Choice of the method of a motion: implicit, or explicit for many bodies."""

from dataclasses import replace

import diffrax as dfx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._compile.compilation import fast_compile
from ..._utils.host import is_traced
from ..._utils.pytrees import stop_gradient
from ..._utils.types import Poses, Scalar, Wrenches
from ...assembly.assembly import HingeAssembly
from ...energies.contact import with_closed_contacts
from ...linalg.block_factors import block_layout
from ...mechanism.mechanism import Mechanism
from ..equations.dofs import DofPartition
from .collocation import Radau


# An explicit method is stable if its step is shorter than about this, divided by the
# largest frequency (rad/s) and by the largest rate of decay (1/s).
_STABLE = 2.5
# A step of the implicit method takes as long as ten explicit ones for 100 bodies, and 30
# for 400, and it needs at least a hundred steps (`benchmarks.lattices`).
_MOST_EXPLICIT_STEPS = 1000


def chosen_solver(
    mechanism: Mechanism,
    inertia: Wrenches,
    dofs: DofPartition,
    displacements: Poses,
    duration: Scalar,
) -> dfx.AbstractSolver:
    """Choose a solver for a motion without constraints of some duration; s.

    It is explicit if the equations of a step would be solved in blocks, and if a
    thousand steps are enough for its stability. A batch is always implicit.
    """
    hinges = mechanism.hinge_assembly
    known = stop_gradient((hinges, inertia, displacements, duration))
    layout = block_layout(hinges.ends, dofs.free)
    if layout is None or is_traced(known):
        return Radau()
    *at_start, duration = known
    steps = duration * largest_rate(*at_start) / _STABLE
    return dfx.Tsit5() if steps <= _MOST_EXPLICIT_STEPS else Radau()


@fast_compile
def largest_rate(
    hinges: HingeAssembly, inertia: Wrenches, displacements: Poses
) -> Scalar:
    """Bound the largest frequency and the largest rate of decay of vibrations; 1/s.

    Both are at most those of one hinge between two bodies that have their share of the
    inertia: the inertia of a body is divided among its hinges. Contacts are closed.

    Source:
        Fried, Bounds on the extremal eigenvalues of the finite element stiffness and mass
        matrices, Journal of Sound and Vibration 22, 1972.
    """
    no_rates = jnp.zeros_like(displacements)
    groups = [
        replace(group, energy=with_closed_contacts(group.energy))
        for group in hinges.groups
    ]
    hinges = replace(hinges, groups=tuple(groups))
    tangent = hinges.tangent_in_motion(displacements, no_rates, ())
    first, second = np.array(tangent.ends)[list(tangent.order)].T
    counts = np.bincount(np.concatenate([first, second]), minlength=hinges.bodies)
    share = jnp.asarray(counts.astype(float))[:, None] / inertia
    a, b = share[first].T, share[second].T
    # Reciprocal square roots of the inertia against the four displacements of a hinge
    scale = jnp.sqrt(jnp.stack([a[0], b[0], a[1] + b[1], a[2] + b[2]], axis=1))

    def largest(matrices: Float[Array, "members 4 4"]) -> Scalar:
        scaled = scale[:, :, None] * matrices * scale[:, None]
        return jnp.max(jnp.sqrt(jnp.sum(scaled**2, axis=(1, 2))))

    frequency = jnp.sqrt(largest(tangent.each.stiffness))
    return jnp.maximum(frequency, largest(tangent.each.damping))
