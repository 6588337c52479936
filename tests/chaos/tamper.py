"""Clock and disk of the roles of a run, changed from outside while it runs.

A small file, mapped into memory by every process of the run, holds how far the clock is off and how long each write
takes. `install` puts both before the real ones; it does nothing where no file is named.
"""

import mmap
import os
import struct
import time
from pathlib import Path

FILE = "ZSDIST_CHAOS_TAMPER"  # variable: path of the file
_FIELDS = struct.Struct("<dd")  # seconds by which the clock is ahead; seconds that each write to the disk takes
_installed = False


class Tamper:
    """Other end of the file, for the script that disturbs a run."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(_FIELDS.pack(0.0, 0.0))
        self._path = path
        os.environ[FILE] = str(path)

    def set(self, *, clock_s: float = 0.0, write_s: float = 0.0) -> None:
        """Set the clock of all processes ahead, and make each of their writes take so long."""
        with self._path.open("r+b") as file:
            file.write(_FIELDS.pack(clock_s, write_s))


def install() -> None:
    """Put the changed clock and disk before those of this process."""
    global _installed
    if _installed or not (path := os.environ.get(FILE)):
        return
    _installed = True
    with open(path, "rb") as file:
        memory = mmap.mmap(file.fileno(), _FIELDS.size, access=mmap.ACCESS_READ)
    real = {name: getattr(os, name) for name in ("write", "fsync", "ftruncate", "replace")}
    real_time = time.time

    def slow(name):
        def call(*arguments, **options):
            if write_s := _FIELDS.unpack(memory)[1]:
                time.sleep(write_s)  # at one piece: a thread that waits for a hung disk does not move
            return real[name](*arguments, **options)

        return call

    for name in real:
        setattr(os, name, slow(name))
    time.time = lambda: real_time() + _FIELDS.unpack(memory)[0]
