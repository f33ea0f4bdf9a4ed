"""Text files of named columns of numbers."""

import csv
import re
from pathlib import Path

import numpy as np

from .validation import shorten


_SEPARATORS = ",;\t"
# This excludes what `float` also accepts: 1_0, and digits of other scripts.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


class CsvFile:
    """The content of a text file of separated values, with column names in line 1.

    The separator is a comma, a semicolon or a tab: the most frequent of these in the
    first line.

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
            raise ValueError(
                f"{path} is not a UTF-8 text file of separated values."
            ) from error
        separator = max(_SEPARATORS, key=lines[0].count)
        # Without `strict`, an unclosed quotation mark hides the following lines.
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

    def location(self, row: int) -> str:
        """Return the file and the line of a row, such as "trials.csv, line 2".

        The index of the row does not count the line of names and empty lines.
        """
        return f"{self.path}, line {self._rows[row][0]}"

    def numbers(
        self, name: str, *, factor: float = 1.0, allow_empty: bool = False
    ) -> np.ndarray:
        """Return the numbers of a column.

        Args:
            name: Name of the column.
            factor: Factor by which the numbers are multiplied.
            allow_empty: Whether entries may be empty; these are NaN.

        Returns:
            The numbers, multiplied by `factor`.

        Raises:
            ValueError: Two columns have this name, a row is too short or too long, or an
                entry is not a finite number. The message names the line; the first line
                is 1.
        """
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
