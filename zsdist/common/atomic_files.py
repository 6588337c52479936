"""Files that are whole or not there, whenever a process dies or a machine stops."""

import os
from pathlib import Path


def replace(path: Path, content: bytes) -> None:
    """Writes a file that is at any time either the old one or the new one."""
    partial = path.with_name(f".{path.name}.partial")
    write(partial, content)
    partial.replace(path)
    settle(path.parent)


def write(path: Path, content: bytes) -> None:
    """Writes a file, and returns once the disk has it."""
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def settle(folder: Path) -> None:
    """Returns once the disk has the names in a folder."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
