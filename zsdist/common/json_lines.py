"""Files of JSON objects, one per line, that grow by appending."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from zsdist.common import atomic_files


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
