"""Journal on disk of everything that a replay has accepted. Acknowledged data survives the process, even `kill -9`.

A journal has a base, a log, and pieces. The base is the state at one moment without the rows of the ring. The log holds
the records since then, in order. Once the log is long enough, a new base replaces both, and the rows from the log
become one more piece. A piece is never rewritten. It is removed as a whole once the ring holds none of its rows. So the
cost depends on the rows written, not on the rows held.

Records are handed to the operating system before they are acknowledged, so they survive the death of the process. A
machine that loses power may lose the last of them, unless `Journal.sync` has forced them onto the disk.

A damaged place costs the records that it hits and nothing else (`zsdist.replay.records`): those of a log, or parts of a
piece. The base is small and there twice. `Journal.damage` names each place.
"""

import os
import re
import secrets
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from zsdist.common import atomic_files, folders
from zsdist.common.ownership import Owned
from zsdist.errors import DamagedError, RunError
from zsdist.replay import records as record_format
from zsdist.replay.records import MARKER_BYTES, Damage, Record

# A log of this length is merged into a new base; a log of so many records is read in a tenth of a second.
COMPACT_BYTES = 16 * 2**20
COMPACT_RECORDS = 256

_BASES = ("base", "copy")
_BASE_MARKER = b"zsdistJ1"  # of the one record of a base
_NAME = re.compile(r"(?P<generation>\d{8,})(-(?P<end>\d{16,}))?\.(?P<kind>base|copy|log|piece|partial)")


class JournalContent(NamedTuple):
    """Content of a journal, without what is damaged.

    Attributes:
        base: newest base.
        pieces: parts of the pieces of rows that belong to it, oldest first.
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
        kind: base, its copy, log, piece, or partial: a base that is being written.
    """

    path: Path
    generation: int
    end: int
    kind: str


class Journal(Owned):
    """Base, log and pieces of one writer, in a folder of its own.

    Args:
        folder: folder of the journal, created if missing; `recover` returns the content of one that exists.
        synced: whether bases and pieces are forced onto the disk before the files that they replace are removed.

    Attributes:
        damage: damaged places that `recover` found.

    Raises:
        RunError: the folder cannot be created.
    """

    def __init__(self, folder: Path, *, synced: bool = False) -> None:
        self.damage: list[Damage] = []
        self._folder, self._synced = folder, synced
        self._log = -1
        self._close_log: Callable[[], object] = lambda: None
        self._marker = b""  # of the log
        self._pieces_marker = secrets.token_bytes(MARKER_BYTES)
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
        """Return the newest base, its pieces and the whole records after it; None if there is no base.

        An incomplete last record, which its writer left when it died, is cut off: it was never acknowledged. New
        records are appended to the others.

        Raises:
            DamagedError: both copies of the base are damaged.
            RunError: a file cannot be read or cut.
        """
        self.damage = []
        files = self._files()
        bases = [file for file in files if file.kind == "base"] or [file for file in files if file.kind == "copy"]
        if not bases:
            return None
        self._generation = bases[-1].generation
        try:
            self._remove(lambda file: file.generation > self._generation)  # files of a base that was never finished
            base = self._read_base()
            self._pieces = {file.path: file.path.stat().st_size for file in self._files() if file.kind == "piece"}
            pieces = [part for path in self._pieces for part in self._read_piece(path)]
            if not self._path("log").exists():
                self.damage.append(Damage(self._path("log"), 0, 0, 1))
            self._open_log()
            content = self._path("log").read_bytes()
            found = record_format.read(content, self._marker, self._path("log"))
            os.ftruncate(self._log, found.end)
        except OSError as error:
            raise self._failed("read", error) from error
        self.damage += found.damage
        self._log_bytes, self._log_records = found.end, found.next_number
        return JournalContent(base, pieces, found.records)

    def rebase(self, base: bytes, piece: Sequence[bytes] = (), *, end: int = 0, oldest: int = 0) -> None:
        """Start a new generation from `base`; remove the old base and log, and pieces that are no longer needed.

        Args:
            base: state without the rows in pieces.
            piece: rows from the log in parts, of which damage costs those that it hits; empty: none.
            end: serial of the first row after the piece; the numbers of rows continue through all pieces.
            oldest: serial of the oldest row that is needed; pieces that end there or earlier are removed.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        self.check_process()
        try:
            self._generation += 1
            self._marker = secrets.token_bytes(MARKER_BYTES)
            if piece:
                path = self._folder / f"{self._generation:08d}-{end:016d}.piece"
                self._pieces[path] = self._write(path, self._pieces_marker, piece)
            content = self._marker + self._pieces_marker + base
            self._base_bytes = sum(
                self._write(self._path(name), _BASE_MARKER, [content]) for name in ("copy", "partial")
            )
            self._open_log()
            self._path("partial").rename(self._path("base"))  # from here on base and piece are valid
            if self._synced:
                atomic_files.sync_folder(self._folder)
            self._remove(lambda file: file.kind != "piece" and file.generation < self._generation)
            self._remove(lambda file: file.kind == "piece" and file.end <= oldest)
        except OSError as error:
            raise self._failed("written", error) from error
        self._log_bytes, self._log_records = 0, 0

    def append(self, records: Sequence[Record]) -> None:
        """Hand records to the operating system in one write; unless power fails, they are safe once this returns.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        self.check_process()
        content = b"".join(
            part
            for number, (kind, record) in enumerate(records, self._log_records)
            for part in (record_format.head(self._marker, number, kind, record), record)
        )
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

    def sync(self) -> None:
        """Return once all appended records are on the disk.

        Raises:
            RunError: the disk reports an error.
        """
        try:
            os.fdatasync(self._log)
        except OSError as error:
            raise self._failed("written", error) from error

    def close(self) -> None:
        """Close the log; closing again does nothing."""
        self._close_log()
        self._log = -1

    def _read_base(self) -> bytes:
        """Return the base from whichever of its two copies is whole, and take over the markers that it names."""
        whole: list[bytes] = []
        for name in _BASES:
            path = self._path(name)
            content = path.read_bytes() if path.exists() else b""
            found = record_format.read(content, _BASE_MARKER, path)
            if len(found.records) == 1 and found.end == len(content) and not found.damage:
                whole.append(found.records[0][1])
            else:
                self.damage.append(Damage(path, 0, len(content), 0))
        if not whole:
            raise DamagedError(f"replay journal {self._folder} is damaged: neither copy of its base is whole")
        self._base_bytes = sum(file.path.stat().st_size for file in self._files() if file.kind in _BASES)
        self._marker, self._pieces_marker = whole[0][:MARKER_BYTES], whole[0][MARKER_BYTES : 2 * MARKER_BYTES]
        return whole[0][2 * MARKER_BYTES :]

    def _read_piece(self, path: Path) -> list[bytes]:
        """Return the whole parts of a piece, and note its damage."""
        content = path.read_bytes()
        found = record_format.read(content, self._pieces_marker, path)
        self.damage += found.damage
        if found.end != len(content):  # a log may end in the middle of a record, a piece may not
            self.damage.append(Damage(path, found.end, len(content) - found.end, 1))
        return [part for _, part in found.records]

    def _write(self, path: Path, marker: bytes, parts: Sequence[bytes]) -> int:
        """Write a base or a piece; return the size of its file in bytes."""
        with path.open("wb") as file:
            for number, part in enumerate(parts):
                file.write(record_format.head(marker, number, 0, part))
                file.write(part)
            file.flush()
            if self._synced:
                os.fsync(file.fileno())
            return file.tell()

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
