"""Files that commands write: checked before the work begins, written when it is done; errors of disks in one line."""

import errno
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from zsdist.common import atomic_files
from zsdist.errors import RunError

OF_THE_SYSTEM = (  # errors that only a user can correct: of names, rights, disks and limits
    errno.ENAMETOOLONG,
    errno.ENOTDIR,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EIO,
    errno.ESTALE,
    errno.EMFILE,
    errno.ENFILE,
)


@contextmanager
def written(what: str) -> Iterator[None]:
    """Turn an error of the system in `OF_THE_SYSTEM` into a `RunError` that says what cannot be written, and why."""
    try:
        yield
    except OSError as error:
        if error.errno not in OF_THE_SYSTEM:
            raise
        raise RunError(f"{what} cannot be written: {error.strerror}") from error


@contextmanager
def made_folder(what: str, folder: Path) -> Iterator[None]:
    """Make a folder where there is none, and remove it again if an error leaves it empty; parents too.

    Args:
        what: name of it in errors, as in `written`, which counts inside too.
        folder: folder to make.
    """
    with written(what):
        made = [path for path in (folder, *folder.parents) if not path.exists()]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            yield
        except BaseException:
            for path in made:
                with suppress(OSError):  # something is in it
                    path.rmdir()
            raise


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
    content = json.dumps(result, indent=1, allow_nan=False) + "\n"
    try:
        if file.exists() and not file.is_file():  # a pipe or a device
            file.write_text(content, encoding="utf-8")
        else:
            atomic_files.replace(file.resolve(), content.encode())
    except OSError as error:
        raise RunError(f"the result cannot be written to {option} {file}: {error.strerror or error}") from error
