"""JSON files of energies, from which a fitted hinge can be read again."""

from pathlib import Path

from ..energies.base import AbstractEnergy
from .conversion import energy_from_record, energy_record


def save_energy(energy: AbstractEnergy, path: str | Path) -> None:
    """Write an energy to a JSON file without rounding.

    Args:
        energy: Energy of one of the classes `Quadratic`, `Polynomial`, `Rational`,
            `SumOfSquares`, `MixedEnergy`, `BeamColumn`, `OneFreedomEnergy`,
            `WithValidityRange`, `Condensed`, `PointCharges` and `AxialSpring`, or a sum
            or a multiple of such energies.
        path: Path of the file. A file that exists is replaced once the new one is
            complete.

    Raises:
        ValueError: The energy is of another class, or has a value that is not finite.
            Nothing is written.
        OSError: The file cannot be written.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax.energies import Polynomial
        >>> rotational = Polynomial(coefficients=[0.1], powers=[(0, 2, 0, 0)])
        >>> with TemporaryDirectory() as folder:
        ...     save_energy(rotational, f"{folder}/hinge.json")
        ...     load_energy(f"{folder}/hinge.json").coefficients
        Array([0.1], dtype=float64)
    """
    from .records import write_record

    write_record(path, "energy", energy_record(energy))


def load_energy(path: str | Path) -> AbstractEnergy:
    """Read an energy from a JSON file that `save_energy` wrote.

    Args:
        path: Path of the file.

    Returns:
        The same energy, without rounding.

    Raises:
        ValueError: The file is damaged or of another version, or an entry is unknown,
            missing or out of range. The message names the file and the entry.
        OSError: The file cannot be read.
    """
    from .records import read_record

    record = read_record(path, "energy")
    try:
        return energy_from_record(record, "energy")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
