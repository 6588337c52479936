"""What a replay has taken in, on its own disk: what was acknowledged outlives the process, `kill -9` included.

A journal is a base, a log, and pieces. The base says how things stood at one moment, all but the bulk of it; the log is
what has come since, in order. Once the log is long enough a new base takes the place of both, and what the log had
brought becomes one more piece of the bulk. No piece is ever written again: it is removed as a whole once nothing in it
is held any more, so that a ring costs what goes into it and never what it holds. Records are handed to the operating
system before anything is acknowledged; it keeps them though the process dies. They are not forced onto the disk: a
machine that loses power may lose the last of them.
"""

import os
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from zsdist.errors import RunError

COMPACT_BYTES = 16 * 2**20  # a log at least this long is folded,
COMPACT_RECORDS = 512  # or one of so many: a successor has read it in a fraction of a second

_HEAD = struct.Struct("<IIB")  # length of the content, CRC-32 of kind and content, kind
_KIND = struct.Struct("<B")

Record = tuple[int, bytes]  # kind, which is the writer's business, and content


class Found(NamedTuple):
    """What a journal holds: the newest base, the pieces that belong to it, oldest first, and the records since."""

    base: bytes
    pieces: list[bytes]
    records: list[Record]


class Journal:
    """One writer's base, log and pieces in a folder of its own.

    Args:
        folder: made where it is missing; of a journal that was there, `recover` tells.

    Raises:
        RunError: the folder cannot be made or read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._log = -1
        self._generation = 0
        self._base_bytes = 0
        self._log_bytes = 0
        self._log_records = 0
        self._pieces: dict[Path, int] = {}  # oldest first; bytes
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._failed("made", error) from error

    @property
    def nbytes(self) -> int:
        """Bytes of base, log and pieces."""
        return self._base_bytes + self._log_bytes + sum(self._pieces.values())

    @property
    def wants_base(self) -> bool:
        """Whether the log is so long that `rebase` is due."""
        return self._log_bytes >= COMPACT_BYTES or self._log_records >= COMPACT_RECORDS

    def recover(self) -> Found | None:
        """The newest base, its pieces and the whole records after it; None where there is no base.

        A last record that was torn by the death of its writer is cut off: nobody was told that it had arrived. The
        journal goes on after the others.

        Raises:
            RunError: a file cannot be read or cut.
        """
        generations = sorted(int(path.stem) for path in self._folder.glob("*.base"))
        if not generations:
            return None
        self._generation = generations[-1]
        try:
            self._remove(lambda path: _generation(path) > self._generation)  # of a base that was never finished
            self._pieces = {path: path.stat().st_size for path in sorted(self._folder.glob("*.piece"))}
            base, pieces = self._path("base").read_bytes(), [path.read_bytes() for path in self._pieces]
            self._open_log()
            content = self._path("log").read_bytes()
            records, self._log_bytes = whole(content)
            os.ftruncate(self._log, self._log_bytes)
        except OSError as error:
            raise self._failed("read", error) from error
        self._base_bytes, self._log_records = len(base), len(records)
        return Found(base, pieces, records)

    def rebase(self, base: bytes, piece: bytes = b"", *, end: int = 0, oldest: int = 0) -> None:
        """Begins anew from `base`; the base and the log before it are removed, and pieces that are no longer needed.

        Args:
            base: says how things stand, all but what is in pieces.
            piece: what the log had brought; empty: nothing.
            end: number of the first item after the piece, of items numbered through all pieces.
            oldest: number of the oldest item that is needed; pieces that end there or earlier are removed.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        try:
            self._generation += 1
            if piece:
                path = self._folder / f"{self._generation:08d}-{end:016d}.piece"
                path.write_bytes(piece)
                self._pieces[path] = len(piece)
            partial = self._path("partial")
            partial.write_bytes(base)
            self._open_log()
            partial.rename(self._path("base"))  # from here on it and the piece count
            self._remove(lambda path: path.suffix != ".piece" and _generation(path) < self._generation)
            self._remove(lambda path: path.suffix == ".piece" and int(path.stem.split("-")[1]) <= oldest)
        except OSError as error:
            raise self._failed("written", error) from error
        self._base_bytes, self._log_bytes, self._log_records = len(base), 0, 0

    def append(self, records: Sequence[Record]) -> None:
        """Hands records to the operating system, all in one write; once it returns they may be acknowledged.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        parts = []
        for kind, content in records:
            checksum = zlib.crc32(content, zlib.crc32(_KIND.pack(kind)))
            parts += (_HEAD.pack(len(content), checksum, kind), content)
        whole = b"".join(parts)
        try:
            written = os.write(self._log, whole)
            if written != len(whole):
                os.ftruncate(self._log, self._log_bytes)
                raise OSError(0, f"{written} of {len(whole)} bytes were written: the disk is full")
        except OSError as error:
            raise self._failed("written", error) from error
        self._log_bytes += len(whole)
        self._log_records += len(records)

    def close(self) -> None:
        """Lets go of the log; closing again does nothing."""
        if self._log >= 0:
            os.close(self._log)
            self._log = -1

    def _remove(self, unneeded: Callable[[Path], bool]) -> None:
        for path in filter(unneeded, list(self._folder.iterdir())):
            path.unlink()
            self._pieces.pop(path, None)

    def _open_log(self) -> None:
        self.close()
        self._log = os.open(self._path("log"), os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)

    def _path(self, suffix: str) -> Path:
        return self._folder / f"{self._generation:08d}.{suffix}"

    def _failed(self, done: str, error: OSError) -> RunError:
        return RunError(f"replay journal {self._folder} cannot be {done}: {error.strerror or error}")


def _generation(path: Path) -> int:
    """Of base, log or piece: how many bases were begun until then."""
    return int(path.stem.split("-")[0])


def whole(content: bytes) -> tuple[list[Record], int]:
    """The records up to the first that is not whole, and how many bytes they take."""
    records, at = [], 0
    while at + _HEAD.size <= len(content):
        length, checksum, kind = _HEAD.unpack_from(content, at)
        record = content[at + _HEAD.size : at + _HEAD.size + length]
        if len(record) < length or zlib.crc32(record, zlib.crc32(_KIND.pack(kind))) != checksum:
            break
        records.append((kind, record))
        at += _HEAD.size + length
    return records, at
