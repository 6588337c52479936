"""Journal on disk of everything that a replay has accepted. Acknowledged data survives the process, even `kill -9`.

A journal has a base, a log, and pieces. The base is the state at one moment without the rows of the ring. The log holds
the records since then, in order. Once the log is long enough, a new base replaces both, and the rows from the log
become one more piece. A piece is never rewritten. It is removed as a whole once the ring holds none of its rows. So the
cost depends on the rows written, not on the rows held.

Records are handed to the operating system before they are acknowledged, so they survive the death of the process. They
are not forced onto the disk: a machine that loses power may lose the last of them.
"""

import os
import re
import struct
import weakref
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from zsdist.common import folders
from zsdist.common.ownership import Owned
from zsdist.errors import RunError

# A log of this length is merged into a new base; a log of so many records is read in a fraction of a second.
COMPACT_BYTES = 16 * 2**20
COMPACT_RECORDS = 512

_HEAD = struct.Struct("<IIB")  # length of the content, CRC-32 of kind and content, kind
_KIND = struct.Struct("<B")
_NAME = re.compile(r"(?P<generation>\d{8,})(-(?P<end>\d{16,}))?\.(?P<kind>base|log|piece|partial)")

Record = tuple[int, bytes]  # kind, defined by the writer, and content


class JournalContent(NamedTuple):
    """Content of a journal.

    Attributes:
        base: newest base.
        pieces: pieces of rows that belong to it, oldest first.
        records: records since the base, oldest first.
    """

    base: bytes
    pieces: list[bytes]
    records: list[Record]


class _File(NamedTuple):
    """File of a journal.

    Attributes:
        path: path of the file.
        generation: number of bases that were begun before or with it.
        end: serial of the first row after a piece; 0 for other files.
        kind: base, log, piece, or partial: a base that is being written.
    """

    path: Path
    generation: int
    end: int
    kind: str


class Journal(Owned):
    """Base, log and pieces of one writer, in a folder of its own.

    Args:
        folder: folder of the journal, created if missing; `recover` returns the content of one that exists.

    Raises:
        RunError: the folder cannot be created.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._log = -1
        self._close_log: Callable[[], object] = lambda: None
        self._generation = 0
        self._base_bytes = 0
        self._log_bytes = 0
        self._log_records = 0
        self._pieces: dict[Path, int] = {}  # their sizes in bytes, oldest first
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._failed("created", error) from error

    @property
    def nbytes(self) -> int:
        """Size of base, log and pieces in bytes."""
        return self._base_bytes + self._log_bytes + sum(self._pieces.values())

    @property
    def wants_base(self) -> bool:
        """True once the log is long enough for a `rebase`."""
        return self._log_bytes >= COMPACT_BYTES or self._log_records >= COMPACT_RECORDS

    def recover(self) -> JournalContent | None:
        """Return the newest base, its pieces and the complete records after it; None if there is no base.

        An incomplete last record, which its writer left when it died, is cut off: it was never acknowledged. New
        records are appended to the others.

        Raises:
            RunError: a file cannot be read or cut.
        """
        generations = [file.generation for file in self._files() if file.kind == "base"]
        if not generations:
            return None
        self._generation = max(generations)
        try:
            self._remove(lambda file: file.generation > self._generation)  # files of a base that was never finished
            self._pieces = {file.path: file.path.stat().st_size for file in self._files() if file.kind == "piece"}
            base, pieces = self._path("base").read_bytes(), [path.read_bytes() for path in self._pieces]
            self._open_log()
            content = self._path("log").read_bytes()
            records, self._log_bytes = complete_records(content)
            os.ftruncate(self._log, self._log_bytes)
        except OSError as error:
            raise self._failed("read", error) from error
        self._base_bytes, self._log_records = len(base), len(records)
        return JournalContent(base, pieces, records)

    def rebase(self, base: bytes, piece: bytes = b"", *, end: int = 0, oldest: int = 0) -> None:
        """Start a new generation from `base`; remove the old base and log, and pieces that are no longer needed.

        Args:
            base: state without the rows in pieces.
            piece: rows from the log; empty: none.
            end: serial of the first row after the piece; the numbers of rows continue through all pieces.
            oldest: serial of the oldest row that is needed; pieces that end there or earlier are removed.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        self.check_process()
        try:
            self._generation += 1
            if piece:
                path = self._folder / f"{self._generation:08d}-{end:016d}.piece"
                path.write_bytes(piece)
                self._pieces[path] = len(piece)
            partial = self._path("partial")
            partial.write_bytes(base)
            self._open_log()
            partial.rename(self._path("base"))  # from here on base and piece are valid
            self._remove(lambda file: file.kind != "piece" and file.generation < self._generation)
            self._remove(lambda file: file.kind == "piece" and file.end <= oldest)
        except OSError as error:
            raise self._failed("written", error) from error
        self._base_bytes, self._log_bytes, self._log_records = len(base), 0, 0

    def append(self, records: Sequence[Record]) -> None:
        """Hand records to the operating system in one write; they may be acknowledged once this returns.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        self.check_process()
        parts: list[bytes] = []
        for kind, record in records:
            checksum = zlib.crc32(record, zlib.crc32(_KIND.pack(kind)))
            parts += (_HEAD.pack(len(record), checksum, kind), record)
        content = b"".join(parts)
        try:
            written = os.write(self._log, content)
            if written != len(content):
                os.ftruncate(self._log, self._log_bytes)
                raise OSError(
                    0,
                    f"{written} of {len(content)} bytes were written: the disk is full, or its file may grow no "
                    "further (ulimit -f)",
                )
        except OSError as error:
            raise self._failed("written", error) from error
        self._log_bytes += len(content)
        self._log_records += len(records)

    def close(self) -> None:
        """Close the log; closing again does nothing."""
        self._close_log()
        self._log = -1

    def _files(self) -> list["_File"]:
        """Return the files of this journal by generation; anything else in the folder is not ours, and stays."""
        found = ((path, _NAME.fullmatch(path.name)) for path in folders.visible(self._folder))
        files = [
            _File(path, int(name["generation"]), int(name["end"] or 0), name["kind"]) for path, name in found if name
        ]
        return sorted(files, key=lambda file: file.generation)

    def _remove(self, unneeded: Callable[["_File"], bool]) -> None:
        for file in filter(unneeded, self._files()):
            file.path.unlink()
            self._pieces.pop(file.path, None)

    def _open_log(self) -> None:
        self.close()
        self._log = os.open(self._path("log"), os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        self._close_log = weakref.finalize(self, os.close, self._log)

    def _path(self, suffix: str) -> Path:
        return self._folder / f"{self._generation:08d}.{suffix}"

    def _failed(self, done: str, error: OSError) -> RunError:
        return RunError(f"replay journal {self._folder} cannot be {done}: {error.strerror or error}")


def complete_records(content: bytes) -> tuple[list[Record], int]:
    """Return the records up to the first incomplete one, and their size in bytes."""
    records, at = [], 0
    while at + _HEAD.size <= len(content):
        length, checksum, kind = _HEAD.unpack_from(content, at)
        record = content[at + _HEAD.size : at + _HEAD.size + length]
        if len(record) < length or zlib.crc32(record, zlib.crc32(_KIND.pack(kind))) != checksum:
            break
        records.append((kind, record))
        at += _HEAD.size + length
    return records, at
