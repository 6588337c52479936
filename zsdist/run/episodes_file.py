"""File of a run's finished episodes: one JSON line for each, in the order in which they finished."""

import json
import os
from pathlib import Path
from typing import Any

from zsdist.common import json_lines
from zsdist.common.ownership import Owned


class EpisodesFile(Owned):
    """File of JSON lines that grows by appending; every line is handed to the operating system at once.

    A scheduler that died may have left a line unfinished, or not have begun it. Its successor appends all lines that
    it knows of, and the file takes those that it lacks.
    """

    def __init__(self, path: Path) -> None:
        """Open a file to append to, made if missing; an unfinished line at its end is cut off."""
        json_lines.cut_unfinished(path)
        self._file = path.open("a", buffering=1, encoding="utf-8")
        self._last = _last_number(path)

    def append(self, record: dict[str, Any]) -> bool:
        """Append a line; return False where the file has the line of that `finished_as` already."""
        if record["finished_as"] <= self._last:
            return False
        self._file.write(json.dumps(record, allow_nan=False) + "\n")
        self._last = record["finished_as"]
        return True

    def sync(self) -> None:
        """Return once all lines are on the disk."""
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file; closing again does nothing."""
        self._file.close()


def _last_number(path: Path) -> int:
    """Return the `finished_as` of the last line that has one; 0 where there is none."""
    for _, line in json_lines.backwards(path):
        try:
            return int(json.loads(line)["finished_as"])
        except (ValueError, KeyError, TypeError):
            continue  # damaged
    return 0
