"""Files that are complete or absent, even if a process dies or the machine stops while they are written."""

import os
from pathlib import Path


def replace(path: Path, content: bytes, *, sync: bool = True) -> None:
    """Replace a file in one step: a reader finds either the old content or the new one.

    Args:
        path: file to replace or make.
        content: its new content.
        sync: whether to return only once it is on the disk; else it may be lost if the machine stops.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        if sync:
            write(partial, content)
        else:
            partial.write_bytes(content)
        partial.replace(path)
    except OSError:
        partial.unlink(missing_ok=True)  # it may be what fills the disk
        raise
    if sync:
        sync_folder(path.parent)


def write(path: Path, content: bytes) -> None:
    """Write a file and return once its content is on the disk."""
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Return once the names of the files in a folder are on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
