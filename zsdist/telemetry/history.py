"""Figures of runs over their whole length, read from their folders, and the settings in which runs differ.

Of a long file only lines at even distances are read, so that a month costs as much as an hour. The distance is a power
of two: while a file grows, the same lines are read again, and curves do not flicker.
"""

import json
import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from zsdist import config
from zsdist.common import setting_trees
from zsdist.errors import ConfigError

POINTS = 400  # at least half as many are read of a long file, and at most this number
WHOLE_BYTES = 512 * 1024  # a smaller file is read as a whole
_ABOUT = ("seed", "run.name", "placement", "transport.", "cluster.")  # settings in which any two runs may differ


def curves(folder: Path) -> dict[str, list[float | None]]:
    """Return the figures of `metrics.jsonl` by name, thinned out; a line that is not complete is left out."""
    return _curves(folder / "metrics.jsonl", _version(folder / "metrics.jsonl"))


def _version(path: Path) -> tuple[int, int]:
    """Return size and time of a file, by which a file that has not changed is not read again."""
    try:
        state = path.stat()
    except OSError:  # not there yet
        return 0, 0
    return state.st_size, state.st_mtime_ns


@lru_cache(maxsize=64)
def _curves(path: Path, version: tuple[int, int]) -> dict[str, list[float | None]]:
    rows = [row for row in map(_parse, _lines(path)) if row is not None]
    if len(rows) > POINTS:
        rows = rows[:: math.ceil(len(rows) / POINTS)]
    names = dict.fromkeys(name for row in rows for name, value in row.items() if is_figure(value))
    return {name: [row[name] if is_figure(row.get(name)) else None for row in rows] for name in names}


def differences(folders: Sequence[Path]) -> dict[str, list[str]]:
    """Return the settings in which runs differ, with the value of each run as text; `?` where it cannot be read."""
    trees = [_settings(folder / "config.yaml", _version(folder / "config.yaml")) for folder in folders]
    names = dict.fromkeys(name for tree in trees for name in tree if not name.startswith(_ABOUT))
    found = {name: [tree.get(name, "?") for tree in trees] for name in names}
    return {name: values for name, values in sorted(found.items()) if len(set(values)) > 1}


@lru_cache(maxsize=64)
def _settings(path: Path, version: tuple[int, int]) -> dict[str, str]:
    try:
        tree = config.load(path).model_dump(mode="json")
    except ConfigError:
        return {}
    return {name: str(value) for name, value in setting_trees.flat(tree).items()}


def _lines(path: Path) -> list[bytes]:
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            if size <= WHOLE_BYTES:
                file.seek(0)
                return file.readlines()
            stride = 2 ** math.ceil(math.log2(size / POINTS))
            found = []
            for offset in range(0, size, stride):
                file.seek(offset)
                if offset:
                    file.readline()  # the rest of a line
                found.append(file.readline())
            return found
    except OSError:  # not there yet
        return []


def _parse(line: bytes) -> dict[str, Any] | None:
    try:
        row = json.loads(line)
    except ValueError:
        return None
    return row if isinstance(row, dict) else None


def is_figure(value: object) -> bool:
    """Return whether a value of a line is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
