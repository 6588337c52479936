"""Files that commands write: checked before the work begins, written when it is done."""

import json
import os
from pathlib import Path
from typing import Any

from zsdist.errors import RunError


def check_place(option: str, file: Path) -> None:
    """Check that a path given by an option can be a file: its folder exists, and it is no folder itself.

    Raises:
        RunError: it cannot.
    """
    if file.is_dir() or not file.resolve().parent.is_dir():
        raise RunError(f"{option} is {str(file)!r}; allowed is a file in a folder that exists")


def check_writable(option: str, file: Path) -> None:
    """Check that a path given by an option is a file that can be written.

    Raises:
        RunError: it is not.
    """
    check_place(option, file)
    if not os.access(file if file.exists() else file.resolve().parent, os.W_OK):
        raise RunError(f"{option} is {str(file)!r}, which cannot be written; allowed is a writable file")


def write_json(option: str, file: Path, result: dict[str, Any]) -> None:
    """Write a result to the file given by an option.

    Raises:
        RunError: it cannot be written.
    """
    try:
        file.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise RunError(f"the result cannot be written to {option} {file}: {error.strerror or error}") from error
