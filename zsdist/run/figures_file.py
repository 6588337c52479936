"""File of a run's figures over time, thinned with age: its size grows with the logarithm of the time that it covers."""

import json
import os
import re
from pathlib import Path
from typing import Any, TextIO

from zsdist.common import atomic_files, json_lines
from zsdist.common.ownership import Owned
from zsdist.telemetry.snapshot import Fields

DENSE_ROWS = 300  # twice as many of the newest rows are all kept: at a row a second those of ten minutes
THINNED_AFTER_ROWS = 1200
ROW = "row"  # first field of a line: the number of the row, from 0 without gaps before any was removed
_BEGINNING = re.compile(rb'\{"row": (\d+)[,}]')


def spacing(age: int, dense: int) -> int:
    """Return how far apart rows of an age are kept: 1 below twice `dense`, then a power of two that grows with the age.

    A row is kept while its number is a multiple of the spacing. Since powers of two divide each other, a row that has
    been removed would never be kept later.
    """
    return 1 << max(0, (age // dense).bit_length() - 1)


class FiguresFile(Owned):
    """File of JSON lines, one a row, that grows by appending and is thinned once in `THINNED_AFTER_ROWS`.

    Rows are numbered in the order in which they are appended, in the field `row`. All rows up to an age of twice
    `DENSE_ROWS` are kept, up to twice that age every second one, and so on. Thinning replaces the file in one step, so
    a crash leaves the old file or the new one, and a reader that has it open reads the old one to its end.
    """

    def __init__(self, path: Path) -> None:
        """Open a file to append to, made if missing; rows continue the numbers that it has.

        A row that a killed process did not finish is cut off.
        """
        json_lines.cut_unfinished(path)
        self._path = path
        self._file = self._opened()
        self._next = _next_number(path)

    def append(self, row: Fields) -> int:
        """Append a row and return its number."""
        number = self._next
        self._file.write(json.dumps({ROW: number, **row}, allow_nan=False) + "\n")
        self._next += 1
        if self._next % THINNED_AFTER_ROWS == 0:
            self._thin()
        return number

    def sync(self) -> None:
        """Return once all rows are on the disk."""
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file; closing again does nothing."""
        self._file.close()

    def _opened(self) -> TextIO:
        return self._path.open("a", buffering=1, encoding="utf-8")

    def _thin(self) -> None:
        kept = []
        self._file.close()
        with self._path.open("rb") as file:
            for position, line in enumerate(file):
                number = _number(line, position)
                if number is not None and number % spacing(self._next - number, DENSE_ROWS) == 0:
                    kept.append(line)
        atomic_files.replace(self._path, b"".join(kept))
        self._file = self._opened()


def _next_number(path: Path) -> int:
    """Return the number of the next row of a file: that of the last row and one more."""
    for _, line in json_lines.backwards(path):
        if (number := _number(line, None)) is not None:
            return number + 1
        with path.open("rb") as file:  # by an earlier version, which did not number rows
            return sum(1 for _ in file)
    return 0


def _number(line: bytes, position: int | None) -> int | None:
    """Return the number of a line's row; `position` where it has none; None where the line is damaged."""
    if match := _BEGINNING.match(line):
        return int(match[1])
    try:
        row: Any = json.loads(line)
        return int(row.get(ROW, position))
    except (ValueError, TypeError, AttributeError):
        return None
