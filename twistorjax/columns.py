"""Files of named columns of numbers."""

import csv
from pathlib import Path

import numpy as np


_SEPARATORS = ",;\t"


class Columns:
    """A text of separated values, whose first line names the columns.

    The separator is a comma, a semicolon or a tab, whichever the first line has most of.

    Args:
        path: of the file.

    Raises:
        ValueError: it is no text.
        OSError: it cannot be read.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            lines = self.path.read_text(encoding="utf-8-sig").splitlines()
        except UnicodeDecodeError as error:
            raise ValueError(f"{path} is not a text of separated values.") from error
        first = lines[0] if lines else ""
        reader = csv.reader(lines, delimiter=max(_SEPARATORS, key=first.count))
        self.names = [name.strip() for name in next(reader, [])]
        self._rows = [
            (reader.line_num, [entry.strip() for entry in row])
            for row in reader
            if any(entry.strip() for entry in row)
        ]

    def __len__(self) -> int:
        return len(self._rows)

    def numbers(self, name: str, *, blank: bool = False) -> np.ndarray:
        """One column; where it may be blank, an empty entry is NaN.

        Raises:
            ValueError: the column is there twice, a row is too short or too long, or an
                entry is no finite number; the text names the line, the first being 1.
        """
        if self.names.count(name) > 1:
            raise ValueError(f"{self.path} has the column {name} more than once.")
        place = self.names.index(name)
        return np.array(
            [self._number(*row, place, blank=blank) for row in self._rows], float
        )

    def _number(self, line: int, row: list[str], place: int, *, blank: bool) -> float:
        if len(row) != len(self.names):
            raise ValueError(
                f"{self.path}, line {line}: it has {len(row)} entries, but the first "
                f"line names {len(self.names)} columns. Is the file whole?"
            )
        entry = row[place]
        if blank and not entry:
            return np.nan
        try:
            value = float(entry)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            hint = " Write the decimal point as a point." if "," in entry else ""
            raise ValueError(
                f"{self.path}, line {line}: {self.names[place]} is {entry or 'empty'}, "
                f"but must be a finite number.{hint}"
            )
        return value
