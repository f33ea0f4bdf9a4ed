"""Displacements, wrenches, and misfits of single hinges of a mechanism, by name."""

from abc import abstractmethod
from collections.abc import Callable
from typing import cast, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import TypeAliasType

from .._utils.host import as_float, on_host
from .._utils.types import Pose, Poses, PosesOrResult, Scalar, Wrench
from .._utils.validation import index_of
from ..assembly.assembly import HingeAssembly
from ..assembly.kinematics import Misfit
from ..energies.base import range_message
from ..geometry import se2
from .changes import HingeState


if TYPE_CHECKING:
    from .mechanism import Mechanism


# Function of the hinges and of the displacements of the bodies; rad, m, m
HingeFunction = TypeAliasType("HingeFunction", Callable[[HingeAssembly, Poses], Array])


class HingeQueries(eqx.Module):
    """Methods of a mechanism that describe one of its hinges."""

    hinge_names: eqx.AbstractVar[tuple[str, ...]]
    reference: eqx.AbstractVar[Poses]
    at: eqx.AbstractVar[Float[Array, "hinges 3"]]
    hinge_assembly: eqx.AbstractVar[HingeAssembly]

    @abstractmethod
    def displacements(
        self, at: PosesOrResult, name: str = "poses", *, single: bool = False
    ) -> Float[Array, "*batch bodies 3"]:
        """Compute the displacements of the bodies from their reference poses."""

    def displacement_of(self, hinge: str, at: PosesOrResult) -> Float[Array, "*batch 3"]:
        """Compute the displacement of frame b of a hinge relative to its frame a.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium, motion, or poses of the bodies; rad, m, m. Prefer an
                equilibrium or a motion: poses lose the digits of displacements that are
                small compared with the positions.

        Returns:
            Angle, and translation along axes 1 and 2 of frame a; for a motion, one row
            for each time; rad, m, m.

        Raises:
            ValueError: There is no hinge of this name, or the poses are not those of the
                bodies.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)

        def pose(hinges: HingeAssembly, displacements: Poses) -> Pose:
            return _hinge_pose(hinges, row, displacements)

        return self.of_hinges(at, pose)

    def wrench_of(self, hinge: str, at: PosesOrResult) -> Float[Array, "*batch 3"]:
        """Compute the wrench that body B exerts on a hinge, about frame b, in its axes.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium, motion, or poses of the bodies; rad, m, m. Prefer an
                equilibrium or a motion: poses lose the digits of displacements that are
                small compared with the positions.

        Returns:
            Moment, and force along axes 1 and 2 of frame b, which are the axial and the
            transverse force of a leaf or a notch; for a motion, one row for each time;
            N m, N, N.

        Raises:
            ValueError: There is no hinge of this name, the poses are not those of the
                bodies, or the hinge is outside the validity range of its energy.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)

        def about_frame_b(hinges: HingeAssembly, displacements: Poses) -> Wrench:
            wrench = hinges.bent_energy_of(row).wrench
            misfits = hinges.misfits
            if misfits is None:
                return wrench(_hinge_pose(hinges, row, displacements))
            # The energy belongs to frame b displaced by half the inverse misfit.
            misfit = Misfit.of(misfits[row])
            x, y = -misfit.e1 - misfit.f2, -misfit.e2 + misfit.f1
            frame = jnp.stack([-misfit.angle, x, y]) / 2
            pose = _hinge_pose(hinges, row, displacements, of_frames=False)
            return se2.transform_wrench(frame, wrench(pose))

        return self.of_hinges(at, about_frame_b)

    def energy_of(self, hinge: str, at: PosesOrResult) -> Float[Array, "*batch"]:
        """Compute the energy that is stored in a hinge.

        Args:
            hinge: Name of the hinge.
            at: Equilibrium, motion, or poses of the bodies; rad, m, m.

        Returns:
            The energy; for a motion, one for each time; J.

        Raises:
            ValueError: There is no hinge of this name, the poses are not those of the
                bodies, or the hinge is outside the validity range of its energy.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)

        def stored(hinges: HingeAssembly, displacements: Poses) -> Scalar:
            energy = hinges.bent_energy_of(row)
            return energy(_hinge_pose(hinges, row, displacements, of_frames=False))

        return self.of_hinges(at, stored)

    def misfit_of(self, hinge: str) -> Pose | None:
        """Return the displacement at which a hinge is not loaded.

        Args:
            hinge: Name of the hinge.

        Returns:
            Displacement (angle, x, y) of frame b relative to frame a, without the bending
            by a gradient of the temperature; None if no hinge of the mechanism has a
            misfit; rad, m, m.

        Raises:
            ValueError: There is no hinge of this name.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        misfits = self.hinge_assembly.misfits
        if misfits is None:
            return None
        xp, (numbers,) = on_host(misfits[row])
        angle, d1, d2, gap1, gap2, _ = numbers
        cos, sin = xp.cos(angle / 2), xp.sin(angle / 2)
        y1, y2 = d1 - cos * gap1, d2 - cos * gap2
        return as_float(xp.stack([angle, cos * y1 - sin * y2, cos * y2 + sin * y1]))

    def of_hinges(
        self, at: PosesOrResult, function: HingeFunction
    ) -> Float[Array, "..."]:
        """Evaluate a function of the hinges at a solution, or at each one of a batch.

        The hinges have the strokes and the temperatures of the solution.

        Args:
            at: Equilibrium, motion, or poses of the bodies; rad, m, m.
            function: Function of the hinges and the displacements of the bodies; rad, m,
                m.

        Returns:
            The values, with the axes of the batch in front.
        """
        displacements = self.displacements(at, "at")
        batch = displacements.shape[:-2]
        flat = displacements.reshape(-1, *self.reference.shape)
        state = HingeState.of_solution(at, batch)
        mechanism = cast("Mechanism", self)  # the only class with these methods

        def evaluate(displacements: Poses, state: HingeState) -> Array:
            return function(state.hinges(mechanism), displacements)

        # One state is not traced, so that a value out of range raises an error.
        if len(flat) == 1:
            single = jax.tree.map(lambda values: values[0], state)
            values = evaluate(flat[0], single)[None]
        else:
            values = jax.vmap(evaluate)(flat, state)
        return values.reshape(*batch, *values.shape[1:])

    def ports(self, hinge: str, poses: Poses) -> tuple[Pose, Pose]:
        """Compute the poses of the two frames of a hinge in the world.

        Args:
            hinge: Name of the hinge.
            poses: Poses of the bodies; rad, m, m.

        Returns:
            Poses of frame a on body A and of frame b on body B; rad, m, m.

        Raises:
            ValueError: There is no hinge of this name.
        """
        row = index_of("`hinge`", "hinge", hinge, self.hinge_names)
        first, second = (
            se2.compose(poses[body], se2.between(self.reference[body], self.at[row]))
            for body in self.hinge_assembly.ends[row]
        )
        return first, second

    def range_messages(self, poses: Poses) -> str:
        """Describe the hinges whose displacement is outside their validity range.

        Args:
            poses: Poses of the bodies; rad, m, m.

        Returns:
            One sentence for each such hinge.
        """
        hinges, displacements = self.hinge_assembly, self.displacements(poses)
        outside = np.asarray(hinges.out_of_range(displacements))
        sentences = []
        for row in map(int, np.flatnonzero(outside)):
            at = hinges.displacement_of(row, displacements)
            message = range_message(hinges.energy_of(row), at)
            sentences.append(f"The hinge {self.hinge_names[row]!r}: {message}.")
        return " ".join(sentences)


def _hinge_pose(
    hinges: HingeAssembly, row: int, displacements: Poses, of_frames: bool = True
) -> Pose:
    """Compute the displacement of a hinge, of its frames or with its misfit."""
    at = hinges.displacement_of(row, displacements, of_frames)
    x, y = at.sigma * at.x1 - at.xi * at.x2, at.sigma * at.x2 + at.xi * at.x1
    return jnp.stack([at.angle, 2 * x, 2 * y])
