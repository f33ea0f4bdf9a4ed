"""Text files of named columns of numbers, and the units of the columns."""

import csv
import re
from pathlib import Path

import numpy as np

from .json_files import decode_text
from .validation import shorten


# Factors from the units of a file to SI units, by SI unit.
UNIT_FACTORS = {
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
    "rad": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": np.pi / 180},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "um/s": 1e-6},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180},
    "N m": {"Nm": 1.0, "kNm": 1e3, "Nmm": 1e-3, "mNm": 1e-3, "uNm": 1e-6},
    "N": {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3},
    "J": {"J": 1.0, "mJ": 1e-3, "uJ": 1e-6, "Nm": 1.0, "Nmm": 1e-3},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
}
# Micro sign, Greek letter mu, degree sign; products of units such as "N mm".
_SPELLINGS = str.maketrans(
    {"\u00b5": "u", "\u03bc": "u", "\u00b0": "deg", " ": "", "*": "", "\u00b7": ""}
)


_SEPARATORS = ",;\t"
# This excludes what `float` also accepts: 1_0, and digits of other scripts.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def unit_factor(
    source: str, header: str, quantity: str, si_unit: str, unit: str
) -> float:
    """Return the factor from the unit of a column to the SI unit of its quantity.

    `source` names the file or the dataset in messages.
    """
    factors = UNIT_FACTORS[si_unit]
    if (found := unit.translate(_SPELLINGS)) not in factors:
        raise ValueError(
            f"{source} has the column {shorten(header)!r} in {shorten(unit)!r}, but the "
            f"unit of {quantity} must be one of {', '.join(factors)}; the letter µ is "
            "accepted for u."
        )
    return factors[found]


class CsvFile:
    """The content of a text file of separated values; its first line has the names.

    Lines that start with `#` are comments. If the first other line has numbers only, the
    comment above it has the column names. The separator is a comma, a semicolon or a tab:
    the most frequent of these in the line of column names.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            text = decode_text(self.path.read_bytes())
        except UnicodeDecodeError as error:
            raise ValueError(
                f"{path} is not a UTF-8 text file of separated values."
            ) from error
        # Comments become empty lines, so that the numbers of lines in messages are right.
        given = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        lines = ["" if line.lstrip().startswith("#") else line for line in given]
        first = next((row for row, line in enumerate(lines) if line.strip()), 0)
        if first and given[first - 1].strip() and _has_numbers_only(lines[first]):
            first -= 1
            lines[first] = given[first].lstrip(" \t#")
        separator = max(_SEPARATORS, key=lines[first].count)
        # Without `strict`, an unclosed quotation mark hides the following lines.
        reader = csv.reader(lines, delimiter=separator, strict=True)
        try:
            for _ in range(first):
                next(reader)
            self.names = [name.strip() for name in next(reader, [])]
            self._rows = [
                (reader.line_num, [entry.strip() for entry in row])
                for row in reader
                if any(entry.strip() for entry in row)
            ]
        except csv.Error as error:
            raise ValueError(
                f"{path}, line {reader.line_num}: an entry cannot be read: {error}. Is a "
                "quotation mark missing?"
            ) from None

    def __len__(self) -> int:
        return len(self._rows)

    def location(self, row: int) -> str:
        """Return the file and the line of a row, such as "trials.csv, line 2".

        The index of the row does not count the line of names and empty lines.
        """
        return f"{self.path}, line {self._rows[row][0]}"

    def numbers(
        self, name: str, *, factor: float = 1.0, allow_empty: bool = False
    ) -> np.ndarray:
        """Return the numbers of a column; empty entries are NaN if they are allowed."""
        if self.names.count(name) > 1:
            raise ValueError(
                f"{self.path} has the column {shorten(name)} more than once."
            )
        column = self.names.index(name)
        return np.array(
            [self._number(row, column, factor, allow_empty) for row in range(len(self))],
            float,
        )

    def _number(self, row: int, column: int, factor: float, allow_empty: bool) -> float:
        """Return one entry as a number, multiplied by `factor`; NaN if it is empty."""
        entries = self._rows[row][1]
        if len(entries) != len(self.names):
            raise ValueError(
                f"{self.location(row)}: it has {len(entries)} entries, but the first "
                f"line names {len(self.names)} columns. Is the file complete?"
            )
        entry = entries[column]
        if allow_empty and not entry:
            return np.nan
        value = factor * float(entry) if _NUMBER.fullmatch(entry) else np.nan
        if not np.isfinite(value):
            hint = " Write the decimal separator as a point." if "," in entry else ""
            hint = " It is too large." if np.isinf(value) else hint
            raise ValueError(
                f"{self.location(row)}: {shorten(self.names[column])} is "
                f"{shorten(entry) or 'empty'}, but must be a finite number.{hint}"
            )
        return value


def _has_numbers_only(line: str) -> bool:
    """Decide whether all entries of a line are numbers, with any separator."""
    return all(_NUMBER.fullmatch(entry) for entry in re.split(r"[,;\t ]+", line.strip()))
