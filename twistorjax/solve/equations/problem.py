"""The arguments of an analysis, checked and converted to arrays."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..._utils.host import as_float, on_host
from ..._utils.pytrees import stop_gradient
from ..._utils.types import NumberLike, Poses, PosesOrResult, Scalar
from ..._utils.validation import require_float64
from ...mechanism.constraints import AbstractConstraint, ConstraintSet, gather_constraints
from ...mechanism.loads import Drive, Load, LoadSet, prescribed_dofs
from ...mechanism.mechanism import Mechanism
from ...results.codes import AnySolution, finish, result_error
from .consistency import constraint_error, require_equilibrium
from .dofs import DofPartition, require_support
from .state import state_in_range
from .system import System


class Problem(NamedTuple):
    """A mechanism with its loads, prescribed displacements, and constraints."""

    mechanism: Mechanism
    loads: LoadSet
    constraints: ConstraintSet
    dofs: DofPartition  # Partition of the degrees of freedom
    targets: tuple[Scalar, ...]  # Displacements of the prescribed ones; rad, m
    time: NumberLike  # Time at which the constraints are evaluated; s

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        loads: Sequence[Load] = (),
        drives: Sequence[Drive] = (),
        constraints: Sequence[AbstractConstraint] = (),
        time: NumberLike = 0.0,
        *,
        held: Sequence[int] = (),
        supported: bool = True,
    ) -> "Problem":
        """Check and convert the arguments of a user.

        Args:
            time: Time at which the constraints are evaluated; s.
            held: Further degrees of freedom whose displacements are prescribed, as zero.
            supported: Whether hinges or constraints must connect all bodies to the fixed
                ones.

        Raises:
            ValueError: Double precision is disabled, a name is unknown, a coordinate is
                prescribed twice, or a body is not supported.
        """
        require_float64(mechanism.reference)
        constraint_set = gather_constraints(mechanism, constraints)
        load_set = LoadSet.of(mechanism, loads)
        driven, targets = prescribed_dofs(mechanism, drives)
        prescribed = (*driven, *held)
        if supported:
            require_support(mechanism, constraint_set.bodies, prescribed)
        dofs = DofPartition.of(mechanism, prescribed)
        if held:
            targets += len(held) * (as_float(0.0),)
        return cls(mechanism, load_set, constraint_set, dofs, targets, time)

    @property
    def system(self) -> System:
        """The equations of equilibrium."""
        xp, targets = on_host(*self.targets)
        return System(
            self.mechanism.hinge_assembly,
            self.loads,
            self.constraints,
            as_float(xp.stack(targets) if targets else np.zeros(0)),
            as_float(self.time),
            self.dofs,
        )

    def state(
        self,
        about: PosesOrResult | None,
        loads: str = "loads",
        held: tuple[int, ...] = (),
    ) -> Poses:
        """Return the displacements about which the equations are linearized; rad, m, m.

        Args:
            about: An equilibrium under the loads, or its poses; None for the reference
                configuration.
            loads: Name of the argument with the loads, for the message.
            held: Degrees of freedom on which unknown constant forces may act.

        Returns:
            The displacements; NaN if the state is traced and not an equilibrium.

        Raises:
            ValueError: The state is not an equilibrium, or a hinge is outside the range
                of its energy, and the state is not traced.
        """
        displacements = state_in_range(self.mechanism, "about", about)
        if about is None and not self.loads.present and self._is_unloaded:
            return displacements
        return require_equilibrium(
            self.mechanism, self.system, displacements, about, loads, held
        )

    @property
    def _is_unloaded(self) -> bool:
        """Whether all hinges are known to be unloaded in the reference configuration."""
        groups = self.mechanism.hinge_assembly.groups
        return all(group.energy.is_unloaded for group in groups)

    def mode_count(self, modes: int | None) -> int:
        """Return a number of modes, by default that of all modes.

        Raises:
            ValueError: There are fewer modes, or none.
        """
        return mode_count(modes, len(self.dofs.free) - self.constraints.size)

    def inconsistency(self, displacements: Poses) -> Exception:
        """Return the error of constraints that are not consistent with displacements."""
        details = constraint_error(
            self.constraints, self.dofs, self.mechanism, displacements, self.time
        )
        return result_error("inconsistent_constraints", (), f" {details}")

    def finish(
        self,
        solution: AnySolution,
        throw: bool,
        state: Poses,
        messages: Mapping[str, str] = MappingProxyType({}),
    ) -> AnySolution:
        """Return a linearized solution; if it failed and may `throw`, raise its error.

        `state` is the state about which the equations are linearized; rad, m, m.
        `messages` has those of this analysis that differ, by the names of the results.
        """

        def error(name: str, batch_index: tuple[int, ...]) -> Exception:
            if name == "inconsistent_constraints" and not batch_index:
                known, at = stop_gradient((self, state))
                return known.inconsistency(at)
            if name in messages:
                return RuntimeError(messages[name])
            return result_error(name, batch_index)

        return finish(solution, throw, error)


def mode_count(modes: int | None, count: int) -> int:
    """Return a number of modes, by default that of all modes, `count`."""
    if modes is None:
        return count
    if not (isinstance(modes, int) and 1 <= modes <= count):
        raise ValueError(
            f"`modes` is {modes!r}, but the mechanism has {count} modes: give an integer "
            f"from 1 to {count}."
        )
    return modes
