"""Files of named columns of numbers."""

import csv
import re
from pathlib import Path

import numpy as np

from .validation import shorten


_SEPARATORS = ",;\t"
# not all that `float` reads: neither 1_0 nor the digits of other scripts
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


class Columns:
    """A text of separated values, whose first line names the columns.

    The separator is a comma, a semicolon or a tab, whichever the first line has most of.

    Args:
        path: Path of the file.

    Raises:
        ValueError: The file is not UTF-8, or an entry has quotation marks that are not
            closed or more than 131,072 characters. The message names the line.
        OSError: The file cannot be read.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            lines = self.path.read_text(encoding="utf-8-sig").split("\n")
        except UnicodeDecodeError as error:
            raise ValueError(f"{path} is not a text of separated values.") from error
        separator = max(_SEPARATORS, key=lines[0].count)
        # strict: otherwise a quotation mark that is not closed hides the lines after it
        reader = csv.reader(lines, delimiter=separator, strict=True)
        try:
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

    def place(self, row: int) -> str:
        """Where a row of numbers is, for messages: the file and the line."""
        return f"{self.path}, line {self._rows[row][0]}"

    def numbers(self, name: str, *, unit: float = 1.0, blank: bool = False) -> np.ndarray:
        """The numbers of one column.

        Args:
            name: Name of the column.
            unit: Factor by which the numbers are multiplied.
            blank: Whether entries may be empty; these are NaN.

        Returns:
            The numbers, in units of `unit`.

        Raises:
            ValueError: The column is there twice, a row is too short or too long, or an
                entry is not a finite number. The message names the line; the first line
                is 1.
        """
        if self.names.count(name) > 1:
            raise ValueError(
                f"{self.path} has the column {shorten(name)} more than once."
            )
        place = self.names.index(name)
        return np.array(
            [self._number(row, place, unit, blank) for row in range(len(self))], float
        )

    def _number(self, number: int, place: int, unit: float, blank: bool) -> float:
        row = self._rows[number][1]
        if len(row) != len(self.names):
            raise ValueError(
                f"{self.place(number)}: it has {len(row)} entries, but the first line "
                f"names {len(self.names)} columns. Is the file whole?"
            )
        entry = row[place]
        if blank and not entry:
            return np.nan
        value = unit * float(entry) if _NUMBER.fullmatch(entry) else np.nan
        if not np.isfinite(value):
            hint = " Write the decimal point as a point." if "," in entry else ""
            hint = " It is too large." if np.isinf(value) else hint
            raise ValueError(
                f"{self.place(number)}: {shorten(self.names[place])} is "
                f"{shorten(entry) or 'empty'}, but must be a finite number.{hint}"
            )
        return value
