"""JSON files of mechanisms."""

from pathlib import Path

from .._utils.json_files import EntryError
from .._utils.validation import require_float64
from ..mechanism.mechanism import Mechanism
from .conversion import mechanism_from_record, mechanism_record


def save_mechanism(mechanism: Mechanism, path: str | Path) -> None:
    """Write a mechanism to a JSON file without rounding.

    Args:
        mechanism: The mechanism. The energies of its hinges must be of the classes that
            `save_energy` can write.
        path: Path of the file. A file that exists is replaced once the new one is
            complete.

    Raises:
        ValueError: Double precision is disabled; the mechanism is that at another
            temperature; a hinge has an energy of another class; a name cannot be written
            as UTF-8; or a value is not finite. Nothing is written.
        OSError: The file cannot be written.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from twistorjax.examples import stage
        >>> with TemporaryDirectory() as folder:
        ...     save_mechanism(stage.microstage(), f"{folder}/stage.json")
        ...     load_mechanism(f"{folder}/stage.json")
        Mechanism of 6 bodies (1, 2, 3, 4, 5, 6), 7 hinges (a, b, c, d, e, f, g);
        fixed: 1, angle and y of 6
    """
    from .records import write_record

    require_float64(mechanism.reference)
    write_record(path, "mechanism", mechanism_record(mechanism))


def load_mechanism(path: str | Path) -> Mechanism:
    """Read a mechanism from a JSON file that `save_mechanism` or a user wrote.

    All values are in SI units. The manual page on files shows the layout.

    Args:
        path: Path of the file.

    Returns:
        The mechanism. Hinges with equal energies share one energy.

    Raises:
        ValueError: The file is damaged or of another version; an entry is unknown,
            missing, of a wrong type or out of range; or the entries do not make a valid
            mechanism. The message names the file and the entry.
        OSError: The file cannot be read.
    """
    from .records import read_record

    record = read_record(path, "mechanism")
    try:
        return mechanism_from_record(record, "mechanism")
    except EntryError as error:
        raise ValueError(f"{path}: {error}") from error
