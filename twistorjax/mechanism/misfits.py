"""Strokes and temperatures of hinges, and the misfits that they change."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._utils.host import all_concrete, as_float, concrete, on_host
from .._utils.stacking import PerPart
from .._utils.types import NamedNumbers, NumberLike, PoseLike, Poses, Scalar, Wrenches
from .._utils.validation import index_of, quote, require_finite, require_pose, warn
from ..assembly.assembly import HingeAssembly
from ..assembly.groups import DampedEnergy, dilate_groups
from ..energies.dilation import dilated
from .material import Expansion


_LARGEST_STRAIN = 0.5  # due to a change of the temperature


class Temperature(NamedTuple):
    """Changes of the temperature of bodies and hinges.

    These are the arguments of `Mechanism.at_temperature`.

    Args:
        change: Change of the temperature; K.
        bodies: Changes of single bodies, by name, instead of `change`; K.
        hinges: Changes of single hinges, by name, instead of `change`; K.
        gradients: Gradients of the temperature along axis 2 of hinges, by name; K/m.

    Example:
        >>> Temperature(5.0, hinges={"heater": 200.0}).hinges
        {'heater': 200.0}
    """

    change: NumberLike = 0.0
    bodies: NamedNumbers = MappingProxyType({})
    hinges: NamedNumbers = MappingProxyType({})
    gradients: NamedNumbers = MappingProxyType({})


class HingeState(NamedTuple):
    """Strokes and temperatures at an instant, or at the instants of a motion."""

    # Strokes of all hinges; None if there are none; rad, m, m
    strokes: Float[Array, "*batch hinges 3"] | None
    # Changes of the temperature; None if it is that of the mechanism
    temperature: Temperature | None

    @classmethod
    def of_solution(cls, solution: Any, batch: tuple[int, ...]) -> "HingeState":
        """Return the states of a solution (none for poses), one row for each."""
        strokes, temperature = (
            getattr(solution, name, None) for name in ("strokes", "temperature")
        )

        def rows(values: Array, trailing: tuple[int, ...]) -> Array:
            return jnp.broadcast_to(values, (*batch, *trailing)).reshape(-1, *trailing)

        if strokes is not None:
            strokes = rows(strokes, strokes.shape[-2:])
        return cls(strokes, jax.tree.map(lambda values: rows(values, ()), temperature))


def require_same_misfits(own: Float[Array, "hinges 6"] | None, at: Any) -> None:
    """Check that an equilibrium has the misfits of the mechanism, if they are known."""
    if not hasattr(at, "misfits"):  # poses, and results that have strokes of their own
        return
    known = all_concrete([x for x in (own, at.misfits) if x is not None])
    if known is None:
        return
    difference = known[0] - known[1] if len(known) == 2 else sum(known)
    if np.any(difference):
        raise ValueError(
            "The equilibrium is that of a mechanism with other misfits, strokes, or "
            "temperatures. Ask the mechanism that was solved, such as the one that "
            "`with_strokes` returned."
        )


def stroke_rows(
    names: Sequence[str], strokes: Mapping[str, PoseLike]
) -> Float[Array, "hinges 3"]:
    """Arrange strokes (rad, m, m) in rows, which are zero for hinges without a stroke."""
    if not isinstance(strokes, Mapping):
        raise ValueError(
            f"`strokes` is {quote(strokes)}, but must be a mapping from names of "
            'hinges to displacements (angle, x, y), such as {"piezo": (0.0, 1e-6, 0.0)}.'
        )
    rows: list[Any] = [np.zeros(3) for _ in names]
    for name, stroke in strokes.items():
        row = index_of("`strokes`", "hinge", name, names)
        where = f"`strokes` of the hinge {name!r}"
        rows[row] = require_pose(where, stroke)
    return as_float(_stacked(rows))


def stroke_forces(
    hinges: HingeAssembly, displacements: Poses, strokes: Float[Array, "hinges 3"]
) -> tuple[Wrenches, Wrenches]:
    """Compute the forces of the hinges on the bodies due to small strokes.

    They are the elastic forces due to strokes (rad, m, m), and the viscous forces due to
    their rates (rad/s, m/s, m/s), to be added to the forces that hinges resist with; N m,
    N, N.
    """
    zero = jnp.zeros_like(strokes)

    def forces(strokes: Array, rates: Array) -> Wrenches:
        displaced = hinges.with_strokes(strokes, rates)
        return displaced.forces_in_motion(displacements, jnp.zeros_like(displacements))[0]

    _, elastic = jax.jvp(forces, (zero, zero), (strokes, zero))
    _, viscous = jax.jvp(forces, (zero, zero), (zero, strokes))
    return elastic, viscous


def expanded(
    assembly: HingeAssembly,
    at: Float[Array, "hinges 3"],
    bodies: Mapping[str, Scalar | None],
    hinges: Mapping[str, Expansion | None],
    temperature: Temperature,
) -> tuple[HingeAssembly, Float[Array, "hinges 3"], Float[Array, " bodies"]]:
    """Expand bodies and hinges, and move hinges; see `Mechanism.at_temperature`.

    `at` are the poses of the hinges in the world (rad, m, m), and `bodies` coefficients
    of expansion (1/K). The strains of the bodies are returned, too.
    """
    change, of_single_bodies, of_single_hinges, gradients = temperature
    _require_expansions(assembly, bodies, hinges, {**of_single_hinges, **gradients})
    names, hinge_names = tuple(bodies), tuple(hinges)
    expansions = hinges.values()
    numbers = (
        _by_name("`bodies`", "body", of_single_bodies, names, change),
        [0.0 if value is None else value for value in bodies.values()],
        _by_name("`hinges`", "hinge", of_single_hinges, hinge_names, change),
        _by_name("`gradients`", "hinge", gradients, hinge_names, 0.0),
        [0.0 if value is None else value.coefficient for value in expansions],
        [np.zeros((2, 2)) if value is None else value.ends for value in expansions],
        [np.zeros(3) if value is None else value.free_turn for value in expansions],
        [0.0 if value is None else value.arc_length for value in expansions],
    )
    xp, (poses, arms, directions, *arrays) = on_host(
        at, assembly.arms, assembly.directions, *map(_stacked, numbers)
    )
    of_bodies, of_material, of_hinges, slopes, coefficient, *shapes = arrays
    clamps, free_turns, arc_length = shapes
    body_strains, hinge_strains = of_bodies * of_material, coefficient * of_hinges
    _require_small_strains("body", names, body_strains)
    _require_small_strains("hinge", hinge_names, hinge_strains)
    # The clamped ends of a hinge, not its middle, move with the bodies, and away from the
    # middle if the hinge expands.
    cos, sin = directions.T[:, :, None]
    along, across = clamps[..., 0], clamps[..., 1]
    to_clamps = xp.stack([cos * along - sin * across, sin * along + cos * across], -1)
    ends = np.array(assembly.ends).reshape(-1, 2)
    moved = body_strains[ends][:, :, None] * (arms + to_clamps)
    moved = moved - hinge_strains[:, None, None] * to_clamps
    middle, (gap_x, gap_y) = xp.sum(moved, axis=1) / 2, (moved[:, 1] - moved[:, 0]).T
    cos, sin = directions.T
    scales, turn = 1 + hinge_strains, -coefficient * arc_length * slopes
    zero = 0 * turn
    columns = [
        zero, zero, zero, cos * gap_x + sin * gap_y, cos * gap_y - sin * gap_x, turn
    ]  # fmt: skip
    warm = replace(
        assembly,
        arms=as_float(arms + middle[:, None]),
        groups=dilate_groups(assembly.groups, scales, free_turns, bool(gradients)),
        sums=PerPart.of_each(list(map(_dilated_sum, assembly.sums, scales))),
    )
    warm = warm.with_more_misfit(as_float(xp.stack(columns, axis=1)))
    moved_at = xp.concatenate([poses[:, :1], poses[:, 1:] + middle], axis=1)
    return warm, as_float(moved_at), as_float(body_strains)


def _require_small_strains(noun: str, names: Sequence[str], strains: Any) -> None:
    """Check that thermal strains are at most 0.5, for which expansion is linear."""
    known = concrete(strains)
    if known is None or np.all(np.abs(known) <= _LARGEST_STRAIN):
        return
    row = int(np.argmax(np.abs(known)))
    raise ValueError(
        f"The {noun} {names[row]!r} would expand by {known[row]:.4g} times its size, but "
        f"thermal strains must be between -{_LARGEST_STRAIN:g} and {_LARGEST_STRAIN:g}. "
        "Changes of the temperature are in kelvin, and coefficients of expansion in 1/K."
    )


def _dilated_sum(given: DampedEnergy | None, scale: NumberLike) -> DampedEnergy | None:
    """Multiply the dimensions of a hinge whose energy is a sum; it keeps its damping."""
    if given is None:
        return None
    energy, damping = given
    return dilated(energy, as_float(scale)), damping


def _require_expansions(
    assembly: HingeAssembly,
    bodies: Mapping[str, Scalar | None],
    hinges: Mapping[str, Expansion | None],
    named: NamedNumbers,
) -> None:
    """Check that there are expansions, and one for each hinge with a temperature."""
    for name in named:
        if name in hinges and hinges[name] is None:
            raise ValueError(
                f"The hinge {name!r} has no `expansion`, so its temperature has no "
                "effect. Give it one: `Hinge(..., expansion=Expansion(material, "
                "length=...))`."
            )
    parts = [*hinges.values(), *bodies.values()]
    if all(expansion is None for expansion in parts):
        raise ValueError(
            "No body and no hinge has an `expansion`, so the temperature has no effect. "
            "Give `Body(..., expansion=12e-6)` (1/K) and `Hinge(..., "
            "expansion=Expansion(material, length=...))`."
        )
    of_bodies = tuple(bodies.values())
    for row, (name, expansion) in enumerate(hinges.items()):
        expands = any(of_bodies[body] is not None for body in assembly.ends[row])
        if expansion is not None or not expands:
            continue
        energy = assembly.energy_of(row)
        if energy.flexure_length is not None:
            warn(
                f"The hinge {name!r} is a flexure without an `expansion`. The bodies "
                "move its middle instead of its clamped ends, and it does not expand. "
                "Give `expansion=Expansion(material, length=...)`, also if its own "
                "temperature does not change."
            )


def _by_name(
    argument: str,
    noun: str,
    given: NamedNumbers,
    names: Sequence[str],
    default: NumberLike,
) -> list[Any]:
    """Return a number for each name."""
    values: list[Any] = [require_finite("`change`", default)] * len(names)
    for name, value in given.items():
        where = f"{argument} of the {noun} {name!r}"
        values[index_of(argument, noun, name, names)] = require_finite(where, value)
    return values


def _stacked(values: Sequence[Any]) -> Float[Array | np.ndarray, "values ..."]:
    """Stack numbers or rows, without a compilation if they are not traced."""
    xp, numbers = on_host(*values)
    return xp.stack(numbers)
