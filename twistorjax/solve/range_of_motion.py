"""Range of motion of a mechanism: how far its input may go until a stress is reached."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from typing_extensions import TypeAliasType

from .._utils.host import as_float
from .._utils.progress import announced
from .._utils.types import NumberLike, PoseLike
from .._utils.validation import index_of, require_positive
from ..assembly.stress import rows_with_stress, strengths
from ..mechanism.constraints import AbstractConstraint
from ..mechanism.loads import Drive, Load, LoadSet
from ..mechanism.material import warn_of_units
from ..mechanism.mechanism import Mechanism
from ..results.codes import (
    finish,
    result_message,
    RESULTS,
)
from ..results.solutions import PoseSolution
from ..results.tables import Column, Columns
from .continuation.range_search import find_ends
from .continuation.setup import changes_by_factor, first_displacements
from .continuation.system import PathSystem
from .equations.problem import Problem
from .equations.state import warn_outside_linear_range
from .equations.stresses import select_stresses, Stresses
from .statics.solution import StateLike


_SIDES = ("backward", "forward")


# One allowable stress, or one for each hinge by its name; Pa
StressLimitLike = TypeAliasType("StressLimitLike", NumberLike | Mapping[str, NumberLike])


class RangeOfMotion(PoseSolution):
    """The two ends of the range of motion of a mechanism.

    Arrays have two rows: the end that is reached with negative factors of the input, and
    that with positive ones. An end is the equilibrium at which the first hinge reaches
    its allowable stress, or the critical point at which the equilibrium becomes unstable
    before.

    Args:
        factors: Factors of the input.
        displacements: Displacement of each body from its reference pose; rad, m, m.
        reference: Poses from which displacements are measured; rad, m, m.
        reactions: External wrench on the fixed and prescribed degrees of freedom of each
            body, about its origin and in world axes; N m, N, N.
        constraint_forces: Constraint forces; N m, N.
        stresses: Stresses in the hinges, beside their allowable stresses.
        by_stress: Whether the stress limits the range; otherwise the stability.
        result: `RESULTS.successful` or the reason of the failure; `result_names` returns
            its name.
        names: Names of the bodies.
        constraint_names: Name of the constraint to which each scalar equation belongs.
    """

    factors: Float[Array, "*batch 2"]
    displacements: Float[Array, "*batch 2 bodies 3"]
    reference: Float[Array, "*batch bodies 3"]
    reactions: Float[Array, "*batch 2 bodies 3"]
    constraint_forces: Float[Array, "*batch 2 entries"]
    stresses: Stresses
    by_stress: Bool[Array, "*batch 2"]
    result: RESULTS
    names: tuple[str, ...] = eqx.field(static=True)
    constraint_names: tuple[str, ...] = eqx.field(static=True)
    _plural: ClassVar[str] = "ends of ranges of motion"
    _result_axes: ClassVar[int] = 1

    def columns(self) -> Columns:
        axes, labels = ("side",), (("side", _SIDES),)
        return {
            "factor": Column(self.factors, axes, "1", labels),
            "by_stress": Column(self.by_stress, axes, "1"),
            **self._body_columns(*axes),
            **self.stresses.columns(*axes),
        }

    def _summary(self, names: np.ndarray) -> str:
        values = map(
            np.asarray,
            (
                self.factors,
                self.by_stress,
                self.stresses.utilization,
                self.displacements,
            ),
        )
        lines = ["side      factor of the input  largest translation (m)  limit"]
        for side, name, factor, by_stress, utilization, displacements in zip(
            _SIDES, names, *values, strict=True
        ):
            hinge = self.stresses.names[int(np.argmax(utilization))]
            limit = f"stress in {hinge!r}" if by_stress else "stability"
            shown = limit if name == "successful" else name
            travel = np.max(np.linalg.norm(displacements[:, 1:], axis=1))
            lines.append(f"{side:<8}  {factor:>19.6g}  {travel:>23.6g}  {shown}")
        return "\n".join(lines)


@announced("range of motion")
def range_of_motion(
    mechanism: Mechanism,
    *,
    loads: Sequence[Load] = (),
    drives: Sequence[Drive] = (),
    strokes: Mapping[str, PoseLike] = MappingProxyType({}),
    stress: StressLimitLike | None = None,
    safety_factor: NumberLike = 1.0,
    constant_loads: Sequence[Load] = (),
    constraints: Sequence[AbstractConstraint] = (),
    start: StateLike | None = None,
    time: NumberLike = 0.0,
    throw: bool = True,
) -> RangeOfMotion:
    """Compute how far an input may go until a hinge reaches its allowable stress.

    The input is multiplied by negative and by positive factors. Displacements may be
    large. The stresses are those of `stresses`, which explains their limits. If the
    equilibrium becomes unstable before, the range ends there. Linear hinges, such as
    `flexures.linear_leaf` and `flexures.notch`, do not buckle under an axial force; use
    `flexures.leaf` or `flexures.surrogate` if a flexure is compressed. The factors
    and the displacements have derivatives of first order with respect to the mechanism,
    its input, and the allowable stress.

    Args:
        mechanism: The mechanism.
        loads: Loads of the input.
        drives: Prescribed displacements of the input.
        strokes: Strokes of actuators of the input, by the names of their hinges; see
            `Mechanism.with_strokes`; rad, m, m.
        stress: Allowable stress of all hinges, or of some hinges by name. That of the
            others is the `strength` of their material; Pa.
        safety_factor: Number by which the allowable stresses are divided.
        constant_loads: Loads that are not multiplied, such as weights.
        constraints: Pins, sliders, and other constraints between the bodies.
        start: Equilibrium without the input, from which the motion begins; by default the
            one that is connected to the reference configuration.
        time: Time at which time-dependent constraints are evaluated; s.
        throw: Whether a failure raises an error; otherwise it is reported by `result`.

    Returns:
        Both ends of the range.

    Raises:
        ValueError: The input is empty, an allowable stress is missing or not positive, or
            `path` would raise an error.
        RuntimeError: A hinge leaves the validity range of its energy before a stress is
            reached, the stress is exceeded without the input, the input does not change
            any stress, or the equilibria cannot be followed.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
        >>> hinge = tj.Hinge("leaf", "wall", "block", leaf, at=(0, 0, 0))
        >>> bodies = [tj.Body("wall"), tj.Body("block")]
        >>> mechanism = tj.Mechanism(bodies, [hinge], fixed=["wall"])
        >>> moment = tj.Load("block", moment=0.05)
        >>> range_of_motion(mechanism, loads=[moment], stress=300e6)
        side      factor of the input  largest translation (m)  limit
        backward                 -2.5              0.000339442  stress in 'leaf'
        forward                   2.5              0.000339442  stress in 'leaf'
    """
    if not loads and not drives and not strokes:
        raise ValueError("The input is empty. Give `loads`, `drives`, or `strokes`.")
    problem = Problem.of(mechanism, loads, drives, constraints, time)
    allowable = _allowable(mechanism, stress) / as_float(
        require_positive("`safety_factor`", safety_factor)
    )
    changes = changes_by_factor(strokes)
    begin = first_displacements(problem, constant_loads, start, changes)
    constant = LoadSet.of(mechanism, constant_loads)
    system = PathSystem.of(problem, constant, begin, changes)
    ends = find_ends(system, begin, allowable)
    hinges, values = mechanism.hinge_assembly, ends.values
    stresses = select_stresses(hinges, ends.stresses, mechanism.hinge_names)
    rows = np.array(rows_with_stress(hinges), int)
    found = RangeOfMotion(
        factors=ends.factor,
        displacements=values.displacements,
        reference=mechanism.reference,
        reactions=values.reactions,
        constraint_forces=values.constraint_forces,
        stresses=replace(stresses, strength=allowable[rows]),
        by_stress=ends.by_stress,
        result=ends.result,
        names=mechanism.names,
        constraint_names=problem.constraints.names(),
    )
    if throw:
        warn_outside_linear_range(mechanism, values.range_shares)

    def error(item: str, batch_index: tuple[int, ...]) -> Exception:
        side, text = _SIDES[batch_index[-1]], result_message(item)
        if item == "out_of_range":
            text = (
                "A hinge leaves the validity range of its energy before an allowable "
                "stress is reached. Give a larger `safety_factor` or a smaller `stress`, "
                "or create the energy for larger displacements, for example by "
                "`surrogate` or `flexures.chain`."
            )
        return RuntimeError(f"The {side} end was not found. {text}")

    return finish(found, throw, error)


def _allowable(
    mechanism: Mechanism, stress: StressLimitLike | None
) -> Float[Array, " hinges"]:
    """Return the allowable stress of each hinge, infinite if it is not limited; Pa."""
    hinges, names = mechanism.hinge_assembly, mechanism.hinge_names
    known = [names[row] for row in rows_with_stress(hinges)]
    limits = strengths(hinges, "static")
    given = {} if stress is None else stress
    if limits is None and isinstance(given, Mapping) and not given:
        raise ValueError(
            "No allowable stress is known. Give `stress` (Pa), or the `strength` of the "
            "`Material` of a flexure."
        )
    if not isinstance(given, Mapping):
        given = dict.fromkeys(known, given)
    limits = jnp.full(len(names), jnp.inf) if limits is None else limits
    for name, value in given.items():
        index_of("`stress`", "hinge", name, known)
        limit = require_positive(f"`stress` of the hinge {name!r}", value)
        warn_of_units(stress=limit)
        limits = limits.at[names.index(name)].set(limit)
    if not known:
        raise ValueError(
            "The stress is not known in any hinge. Create the energies from dimensions, "
            "by `flexures.leaf`, `flexures.notch`, or `surrogate` of a `flexures.Beam`."
        )
    return limits
