"""What was measured of a hinge: displacements, what they took, and errors against it."""

from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..._utils.csv_files import Columns
from ..._utils.validation import shorten


_POSE = ("angle_rad", "px_m", "py_m")
_WRENCH = ("moment_Nm", "fx_N", "fy_N")
_ENERGY = "energy_J"


class Trials(eqx.Module):
    """Displacements of a hinge, with the wrench or the energy that each took, or both.

    Args:
        poses: frame b seen from frame a, a row for each trial; rad, m, m.
        wrenches: that body B exerted on the hinge there: about the displaced origin of b,
            in its axes; N m, N, N.
        energies: stored there; J.
        wrench_deviations: standard deviation of each wrench, or one row for all. By
            default the components' own root mean squares, so that each counts alike;
            N m, N, N.
        energy_deviations: standard deviation of each energy, or one for all; J.

    Raises:
        ValueError: there is neither a wrench nor an energy; shapes do not fit; a value is
            not finite, or a standard deviation not positive.

    Example:
        >>> trials = Trials([[0.1, 0.0, 0.0]], wrenches=[[0.2, 0.0, 0.0]])
        >>> len(trials)
        1
    """

    poses: Float[Array, "trials 3"]
    wrenches: Float[Array, "trials 3"] | None
    energies: Float[Array, " trials"] | None
    wrench_deviations: Float[Array, "trials 3"] | None
    energy_deviations: Float[Array, " trials"] | None

    def __init__(
        self,
        poses: Float[ArrayLike, "trials 3"] | Sequence[Sequence[ArrayLike]],
        wrenches: Float[ArrayLike, "trials 3"]
        | Sequence[Sequence[ArrayLike]]
        | None = None,
        energies: Float[ArrayLike, " trials"] | Sequence[ArrayLike] | None = None,
        *,
        wrench_deviations: Float[ArrayLike, "*trials 3"]
        | Sequence[ArrayLike]
        | None = None,
        energy_deviations: Float[ArrayLike, "*trials"]
        | Sequence[ArrayLike]
        | None = None,
    ):
        if wrenches is None and energies is None:
            raise ValueError("`Trials` need `wrenches` or `energies`, or both.")
        self.poses = _finite("poses", poses, None)
        count = len(self.poses)
        self.wrenches = self.energies = None
        self.wrench_deviations = self.energy_deviations = None
        if wrenches is not None:
            self.wrenches = _finite("wrenches", wrenches, (count, 3))
            if wrench_deviations is None:
                wrench_deviations = _size(self.wrenches)
            self.wrench_deviations = _deviations("wrench", wrench_deviations, (count, 3))
        if energies is not None:
            self.energies = _finite("energies", energies, (count,))
            if energy_deviations is None:
                energy_deviations = _size(self.energies)
            self.energy_deviations = _deviations("energy", energy_deviations, (count,))

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def reach(self) -> float:
        """The largest translation; one, where there is none; m."""
        far = np.linalg.norm(np.asarray(self.poses[:, 1:]), axis=1)
        return float(far.max()) or 1.0

    def __getitem__(self, rows: np.ndarray) -> "Trials":
        """Some of the trials."""

        def some(values: Array | None) -> Array | None:
            return None if values is None else values[rows]

        return Trials(
            self.poses[rows],
            some(self.wrenches),
            some(self.energies),
            wrench_deviations=some(self.wrench_deviations),
            energy_deviations=some(self.energy_deviations),
        )


class Errors(eqx.Module):
    """How far an energy is from trials.

    Args:
        wrench: root mean square by component; N m, N, N. NaN where none was measured.
        largest: the same of the single largest; N m, N, N.
        relative: root mean square over that of what was measured.
        energy: root mean square; J. NaN where none was measured.
        largest_energy: the largest; J.
    """

    wrench: Float[np.ndarray, "3"]
    largest: Float[np.ndarray, "3"]
    relative: Float[np.ndarray, "3"]
    energy: float
    largest_energy: float


def compared(
    trials: Trials,
    wrenches: Float[np.ndarray, "trials 3"],
    energies: Float[np.ndarray, " trials"],
) -> Errors:
    """How far from trials is what an energy says at their poses.

    Args:
        trials: measured.
        wrenches: of the energy at their poses; N m, N, N.
        energies: there; J. Those of what was not measured are left aside.

    Example:
        >>> trials = Trials([[0.1, 0.0, 0.0]], energies=[2.0])
        >>> compared(trials, np.zeros((1, 3)), np.array([1.5])).energy
        0.5
    """
    left = []
    if trials.wrenches is not None:
        gap = np.asarray(trials.wrenches) - wrenches
        left.append(gap / np.asarray(trials.wrench_deviations))
    if trials.energies is not None:
        gap = np.asarray(trials.energies) - energies
        left.append((gap / np.asarray(trials.energy_deviations))[:, None])
    return measured(trials, np.concatenate(left, axis=1))


def measured(trials: Trials, residual: Float[np.ndarray, "trials numbers"]) -> Errors:
    """Errors in their units, from those in standard deviations.

    Args:
        trials: whose deviations these are.
        residual: of each trial: of its wrench, and last of its energy, as measured.
    """
    wrench, largest, relative = (np.full(3, np.nan) for _ in range(3))
    energy = largest_energy = np.nan
    if trials.wrenches is not None:
        error = residual[:, :3] * np.asarray(trials.wrench_deviations)
        wrench = np.sqrt(np.mean(error**2, axis=0))
        largest = np.max(np.abs(error), axis=0)
        size = np.sqrt(np.mean(np.asarray(trials.wrenches) ** 2, axis=0))
        relative = wrench / np.where(size > 0, size, np.nan)
    if trials.energies is not None:
        error = residual[:, -1] * np.asarray(trials.energy_deviations)
        energy = float(np.sqrt(np.mean(error**2)))
        largest_energy = float(np.max(np.abs(error)))
    return Errors(wrench, largest, relative, energy, largest_energy)


def read_trials(path: str | Path) -> Trials:
    """Reads trials from a file of separated values, a trial a line.

    Args:
        path: of the file. Its first line names the columns: angle_rad, px_m, py_m for the
            pose; moment_Nm, fx_N, fy_N for the wrench, energy_J for the energy, one of
            these or both; and their standard deviations where they are known, as
            sd_moment_Nm, sd_fx_N, sd_fy_N, sd_energy_J. Others are left aside.

    Raises:
        ValueError: a column is missing or named twice, a row is too short or too long, an
            entry is no finite number; the text names the line, the first being 1.
        OSError: the file cannot be read.
    """
    file = Columns(path)
    has_wrench = any(name in file.names for name in _WRENCH)
    wanted = [*_POSE, *(_WRENCH if has_wrench else ())]
    if not has_wrench or _ENERGY in file.names:
        wanted.append(_ENERGY)
    spreads = [f"sd_{name}" for name in _WRENCH]
    has_spreads = any(name in file.names for name in spreads)
    wanted += spreads if has_spreads else ()
    if missing := [name for name in wanted if name not in file.names]:
        raise ValueError(
            f"{path} lacks the column {', '.join(missing)}: its first line is "
            f"{shorten(', '.join(file.names), 300) or 'empty'}, but must name "
            f"{', '.join(_POSE)}, and "
            f"{', '.join(_WRENCH)} or {_ENERGY} or all of them; standard deviations of "
            "the wrench for all three components, or for none."
        )
    if f"sd_{_ENERGY}" in file.names:
        wanted.append(f"sd_{_ENERGY}")
    if not len(file):
        raise ValueError(f"{path} has no trials: only the line of names.")
    columns = {name: file.numbers(name) for name in wanted}

    def block(names: Sequence[str]) -> np.ndarray:
        return np.stack([columns[name] for name in names], axis=1)

    try:
        return Trials(
            block(_POSE),
            block(_WRENCH) if has_wrench else None,
            columns.get(_ENERGY),
            wrench_deviations=block(spreads) if has_spreads else None,
            energy_deviations=columns.get(f"sd_{_ENERGY}"),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _finite(name: str, given, shape: tuple[int, ...] | None) -> Array:
    values = jnp.asarray(given, float)
    if shape is None and (values.ndim != 2 or values.shape[1] != 3 or not len(values)):
        raise ValueError(
            f"`{name}` has shape {values.shape}, but must have a row (angle, x, y) for "
            "each trial."
        )
    if shape is not None and values.shape != shape:
        raise ValueError(
            f"`{name}` has shape {values.shape}, but for {shape[0]} poses must have "
            f"{shape}."
        )
    if not np.all(np.isfinite(values)):
        row = int(np.argwhere(~np.isfinite(values))[0][0])
        raise ValueError(f"`{name}[{row}]` is {values[row]}, but must be finite.")
    return values


def _size(values: Array) -> Array:
    """The root mean square of each column; one, where all are zero."""
    size = jnp.sqrt(jnp.mean(values**2, axis=0))
    return jnp.where(size > 0, size, 1.0)


def _deviations(name: str, given, shape: tuple[int, ...]) -> Array:
    values = jnp.asarray(given, float)
    try:
        values = jnp.broadcast_to(values, shape)
    except ValueError:
        raise ValueError(
            f"`{name}_deviations` has shape {values.shape}, but must fit {shape}."
        ) from None
    if not np.all((values > 0) & np.isfinite(values)):
        raise ValueError(f"`{name}_deviations` must be positive and finite.")
    return values
