"""Measured displacements, wrenches and energies of a hinge, and errors of an energy."""

from collections.abc import Iterable
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ..._utils.csv_files import CsvFile, unit_factor
from ..._utils.types import (
    EnergiesLike,
    EnergyDeviationsLike,
    TrialsLike,
    WrenchDeviationsLike,
)
from ..._utils.validation import require_array, require_deviations, shorten


_POSE = {"angle": "rad", "px": "m", "py": "m"}
_WRENCH = {"moment": "N m", "fx": "N", "fy": "N"}
_ENERGY = {"energy": "J"}
_DEVIATIONS = {f"sd_{name}": unit for name, unit in {**_WRENCH, **_ENERGY}.items()}


class Trials(eqx.Module):
    """Measured displacements of a hinge, with the wrench or the energy of each, or both.

    Args:
        poses: Poses of frame b relative to frame a, a row for each trial; rad, m, m.
        wrenches: Wrenches that body B exerts on the hinge, about the displaced origin of
            frame b and in its axes; N m, N, N.
        energies: Stored energies; J.
        wrench_deviations: Standard deviations of the wrenches, one row for each trial or
            one row for all. By default the rms value of each component, so that all
            components have the same weight; N m, N, N.
        energy_deviations: Standard deviations of the energies, one for each trial or one
            for all. By default the rms value; J.

    Raises:
        ValueError: There are neither wrenches nor energies; the shapes do not match; a
            value is not finite; a standard deviation is not positive.

    Example:
        >>> pose = [0.1, 0.0, 0.0]  # rad, m, m
        >>> wrench = [0.2, 0.0, 0.0]  # N m, N, N
        >>> trials = Trials(poses=[pose], wrenches=[wrench])
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
        poses: TrialsLike,
        wrenches: TrialsLike | None = None,
        energies: EnergiesLike | None = None,
        *,
        wrench_deviations: WrenchDeviationsLike | None = None,
        energy_deviations: EnergyDeviationsLike | None = None,
    ):
        if wrenches is None and energies is None:
            raise ValueError("`Trials` need `wrenches` or `energies` or both.")
        row = "have a row (angle, x, y) for each trial"
        self.poses = require_array("`poses`", poses, (None, 3), row)
        count = len(self.poses)
        if not count:
            raise ValueError(f"`poses` has shape (0, 3), but must {row}.")
        self.wrenches = self.energies = None
        self.wrench_deviations = self.energy_deviations = None
        if wrenches is not None:
            row = f"have a row (moment, force 1, force 2) for each of {count} poses"
            self.wrenches = require_array("`wrenches`", wrenches, (count, 3), row)
            if wrench_deviations is None:
                wrench_deviations = _root_mean_square(self.wrenches)
            self.wrench_deviations = require_deviations(
                "`wrench_deviations`", wrench_deviations, (count, 3)
            )
        if energies is not None:
            number = f"have one number for each of {count} poses"
            self.energies = require_array("`energies`", energies, (count,), number)
            if energy_deviations is None:
                energy_deviations = _root_mean_square(self.energies)
            self.energy_deviations = require_deviations(
                "`energy_deviations`", energy_deviations, (count,)
            )

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def largest_translation(self) -> float:
        """Largest magnitude of a translation, or one if all translations are zero; m."""
        distances = np.linalg.norm(np.asarray(self.poses)[:, 1:], axis=1)
        return float(distances.max()) or 1.0

    def __getitem__(self, rows: np.ndarray) -> "Trials":
        """Select some of the trials."""

        def select(values: Array | None) -> np.ndarray | None:
            return None if values is None else np.asarray(values)[rows]

        return Trials(
            np.asarray(self.poses)[rows],
            select(self.wrenches),
            select(self.energies),
            wrench_deviations=select(self.wrench_deviations),
            energy_deviations=select(self.energy_deviations),
        )

    def averages(self) -> tuple["Trials", Int[np.ndarray, " trials"]]:
        """Average the trials with the same pose.

        A fit to the averages, with their smaller standard deviations, is one to all
        trials.

        Returns:
            A trial for each pose, and its row for each of these trials.
        """
        poses = np.asarray(self.poses)
        steps = 1e-9 * np.maximum(np.max(np.abs(poses), axis=0), np.finfo(float).tiny)
        _, first, rows = np.unique(
            np.round(poses / steps), axis=0, return_index=True, return_inverse=True
        )
        if len(first) == len(self):
            return self, np.arange(len(self))
        rows = rows.reshape(-1)

        def average(
            given: Array | None, deviations: Array | None
        ) -> tuple[np.ndarray | None, np.ndarray | None]:
            if given is None or deviations is None:
                return None, None
            values, weights = np.asarray(given), 1 / np.asarray(deviations) ** 2
            total, moment = np.zeros((2, len(first), *values.shape[1:]))
            np.add.at(total, rows, weights)
            np.add.at(moment, rows, weights * values)
            return moment / total, 1 / np.sqrt(total)

        wrenches, wrench_deviations = average(self.wrenches, self.wrench_deviations)
        energies, energy_deviations = average(self.energies, self.energy_deviations)
        averages = Trials(
            poses[first],
            wrenches,
            energies,
            wrench_deviations=wrench_deviations,
            energy_deviations=energy_deviations,
        )
        return averages, rows

    def predictions(
        self, residuals: Float[np.ndarray, "trials values"]
    ) -> tuple[Float[np.ndarray, "trials 3"], Float[np.ndarray, " trials"]]:
        """Return predicted wrenches and energies from their residuals.

        The residuals are those of `errors_of_residuals`. Predictions of quantities that
        were not measured are NaN.
        """
        wrenches, energies = np.full((len(self), 3), np.nan), np.full(len(self), np.nan)
        if self.wrenches is not None:
            errors = residuals[:, :3] * np.asarray(self.wrench_deviations)
            wrenches = np.asarray(self.wrenches) + errors
        if self.energies is not None:
            errors = residuals[:, -1] * np.asarray(self.energy_deviations)
            energies = np.asarray(self.energies) + errors
        return wrenches, energies


class Errors(eqx.Module):
    """Errors of an energy at trials.

    Args:
        rms_wrench: Rms error of each component of the wrench, NaN without measured
            wrenches; N m, N, N.
        largest_wrench: Largest error of each component of the wrench; N m, N, N.
        relative: Rms error divided by the rms value of the measured component; for a
            component that is nearly zero, divided by a hundredth of that of the force, or
            of the force times the largest translation.
        rms_energy: Rms error of the energy, NaN without measured energies; J.
        largest_energy: Largest error of the energy; J.
    """

    rms_wrench: Float[np.ndarray, "3"]
    largest_wrench: Float[np.ndarray, "3"]
    relative: Float[np.ndarray, "3"]
    rms_energy: float
    largest_energy: float


def errors_of_predictions(
    trials: Trials,
    wrenches: Float[np.ndarray, "trials 3"],
    energies: Float[np.ndarray, " trials"],
) -> Errors:
    """Compare predicted wrenches (N m, N, N) and energies (J) with trials.

    Predictions of quantities that were not measured are ignored.

    Example:
        >>> trials = Trials(poses=[[0.1, 0.0, 0.0]], energies=[2.0])
        >>> wrenches, energies = np.zeros((1, 3)), np.array([1.5])
        >>> errors_of_predictions(trials, wrenches, energies).rms_energy
        0.5
    """
    residuals = []
    if trials.wrenches is not None:
        difference = wrenches - np.asarray(trials.wrenches)
        residuals.append(difference / np.asarray(trials.wrench_deviations))
    if trials.energies is not None:
        difference = energies - np.asarray(trials.energies)
        residuals.append((difference / np.asarray(trials.energy_deviations))[:, None])
    return errors_of_residuals(trials, np.concatenate(residuals, axis=1))


def errors_of_residuals(
    trials: Trials, residuals: Float[np.ndarray, "trials values"]
) -> Errors:
    """Convert residuals in standard deviations to errors.

    A row has the residuals of the wrench, then of the energy, as far as these were
    measured.
    """
    rms_wrench, largest_wrench, relative = (np.full(3, np.nan) for _ in range(3))
    rms_energy = largest_energy = np.nan
    if trials.wrenches is not None:
        error = residuals[:, :3] * np.asarray(trials.wrench_deviations)
        rms_wrench = np.sqrt(np.mean(error**2, axis=0))
        largest_wrench = np.max(np.abs(error), axis=0)
        measured = np.sqrt(np.mean(np.asarray(trials.wrenches) ** 2, axis=0))
        force = np.linalg.norm(measured[1:])
        smallest = 0.01 * force * np.array([trials.largest_translation, 1.0, 1.0])
        measured = np.maximum(measured, smallest)
        relative = rms_wrench / np.where(measured > 0, measured, np.nan)
    if trials.energies is not None:
        error = residuals[:, -1] * np.asarray(trials.energy_deviations)
        rms_energy = float(np.sqrt(np.mean(error**2)))
        largest_energy = float(np.max(np.abs(error)))
    return Errors(rms_wrench, largest_wrench, relative, rms_energy, largest_energy)


def read_trials(path: str | Path) -> Trials:
    """Read trials from a text file with a line of column names and a line for each trial.

    The columns are separated by commas, semicolons or tabs. Their names have the units:

    * `angle_rad`, `px_m`, `py_m`: the pose;
    * `moment_Nm`, `fx_N`, `fy_N`: the wrench; or `energy_J`: the energy; or both;
    * `sd_moment_Nm`, `sd_fx_N`, `sd_fy_N`, `sd_energy_J`: standard deviations, optional.

    Other units are converted: rad, mrad, urad, deg; m, cm, mm, um, nm; Nm, kNm, Nmm, mNm,
    uNm; N, mN, uN, kN; J, mJ, uJ, Nm, Nmm. Other columns are ignored, and so are lines
    that start with `#`.

    Args:
        path: Path of the file.

    Returns:
        The trials, in the order of the lines; in SI units.

    Raises:
        ValueError: A column is missing or given twice, a unit is not one of its quantity,
            a line is too short or too long, or an entry is not a finite number. The
            message names the line; the first line of the file is line 1.
        OSError: The file cannot be read.
    """
    file = CsvFile(path)
    columns: dict[str, np.ndarray] = {}
    for header in file.names:
        name, _, unit = header.removeprefix("sd_").partition("_")
        name = "sd_" * header.startswith("sd_") + name
        si_unit = {**_POSE, **_DEVIATIONS, **_WRENCH, **_ENERGY}.get(name)
        if si_unit is None or not unit:
            continue
        if name in columns and file.names.count(header) == 1:
            raise ValueError(f"{path} has the column {name} twice, in different units.")
        factor = unit_factor(str(path), header, name, si_unit, unit)
        columns[name] = file.numbers(header, factor=factor)
    has_wrench = any(name in columns for name in _WRENCH)
    required = {**_POSE, **(_WRENCH if has_wrench else _ENERGY)}
    has_deviations = any(f"sd_{name}" in columns for name in _WRENCH)
    if has_deviations:
        required |= {f"sd_{name}": unit for name, unit in _WRENCH.items()}
    if missing := [name for name in required if name not in columns]:
        raise ValueError(
            f"{path} lacks the column {_with_units(missing)}. Its first line is "
            f"{shorten(', '.join(file.names), 300) or 'empty'}, but must have "
            f"{_with_units(_POSE)}, and {_with_units(_WRENCH)} or {_with_units(_ENERGY)} "
            "or all of these; other units are converted: angle_deg, px_mm, moment_Nmm. "
            f"Optional are the standard deviations {_with_units(_DEVIATIONS)}; those of "
            "the wrench must be given for all three components or for none."
        )
    if not len(file):
        raise ValueError(f"{path} has no trials, only a line of column names.")

    def block(names: Iterable[str]) -> np.ndarray:
        return np.stack([columns[name] for name in names], axis=1)

    deviations = [f"sd_{name}" for name in _WRENCH]
    try:
        return Trials(
            block(_POSE),
            block(_WRENCH) if has_wrench else None,
            columns.get("energy"),
            wrench_deviations=block(deviations) if has_deviations else None,
            energy_deviations=columns.get("sd_energy"),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _with_units(names: Iterable[str]) -> str:
    """List the names of columns with their SI units, such as "px_m, py_m"."""
    units = {**_POSE, **_WRENCH, **_ENERGY, **_DEVIATIONS}
    return ", ".join(f"{name}_{units[name].replace(' ', '')}" for name in names)


def _root_mean_square(values: Array) -> np.ndarray:
    """Compute the rms value of each column, or one for a column of zeros."""
    rms = np.sqrt(np.mean(np.asarray(values) ** 2, axis=0))
    return np.where(rms > 0, rms, 1.0)
