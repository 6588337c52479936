"""Files of JSON objects, one per line, that grow by appending."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from zsdist.common import atomic_files

BLOCK_BYTES = 65_536  # read at once


def cut(path: Path, belongs: Callable[[dict[str, Any]], bool]) -> None:
    """Cut a file off after its last object that belongs; a line that a killed process did not finish goes too.

    The file is read from its end, so that the work is in proportion to what is cut off. A file that does not exist is
    left alone.

    Args:
        path: path of the file.
        belongs: tells whether an object belongs; one for which it raises `KeyError` does not.
    """
    if not path.exists():
        return
    for end, line in backwards(path):
        try:
            if belongs(json.loads(line)):
                os.truncate(path, end)
                return
        except (ValueError, KeyError):
            continue
    os.truncate(path, 0)


def cut_unfinished(path: Path) -> None:
    """Cut off a line at the end of a file that a killed process did not finish; a missing file is left alone."""
    if path.is_file():
        end = next((end for end, _ in backwards(path)), 0)
        if end < path.stat().st_size:
            os.truncate(path, end)


def backwards(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the whole lines of a file from the last to the first, each after the offset at which it ends."""
    with path.open("rb") as file:
        begin = end = file.seek(0, os.SEEK_END)
        held = b""  # from `begin` to `end`
        while begin > 0:
            size = min(BLOCK_BYTES, begin)
            begin -= size
            file.seek(begin)
            held = file.read(size) + held
            lines = held.splitlines(keepends=True)
            held = lines[0] if begin else b""  # its beginning may be in the block before
            for line in reversed(lines[1:] if begin else lines):
                if line.endswith(b"\n"):
                    yield end, line
                end -= len(line)


def prune(path: Path, is_stale: Callable[[dict[str, Any]], bool]) -> None:
    """Remove stale lines from a file, and lines that a killed process did not finish.

    Kept lines stay as they are, byte for byte. A file that does not exist is left alone.

    Args:
        path: path of the file, which is replaced in one step.
        is_stale: tells whether an object is removed; an object for which it raises `KeyError` is removed too.
    """
    if not path.exists():
        return
    kept = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            if not is_stale(json.loads(line)):
                kept.append(line)
        except (ValueError, KeyError):
            continue  # the line that a killed process did not finish
    atomic_files.replace(path, "".join(line + "\n" for line in kept).encode())
