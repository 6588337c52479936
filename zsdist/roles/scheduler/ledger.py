"""Ledger of the scheduler: an append-only file of all that it has accepted and decided, from which a successor goes on.

An entry is handed to the operating system before it has an effect outside: before a frame is acknowledged, and before
orders are published that follow from a decision. Entries are numbered, so that a ledger from which one is missing is
never believed.
"""

import struct
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

from zsdist.common import atomic_files
from zsdist.errors import DecodeError, RunError
from zsdist.replay.journal import Journal, Record
from zsdist.wire import codec
from zsdist.wire.messages import State

FORMAT = 2  # of bases and entries; a ledger of another one is not read
_NUMBER = struct.Struct("<I")  # before the content of each entry: its number since the base


class LedgerEntry(IntEnum):
    """Kinds of entries."""

    FRAME = 1  # a frame of records as it arrived, once all frames before it have arrived
    EPOCH = 2  # JSON: an actor and the epoch that was issued to it
    GRANT = 3  # JSON: arguments of `Leases.grant`
    MERGED = 4  # JSON: the seconds that the merge took, which has ended
    LEFT = 6  # JSON: an actor that is gone, and its last epoch
    STATUS = 5  # JSON: those fields of `RunProgress.status` that have changed


class LedgerContent(NamedTuple):
    """Content of a ledger.

    Attributes:
        base: what was last given to `Ledger.rebase`.
        entries: entries since then, oldest first.
    """

    base: dict[str, Any]
    entries: list[Record]


def read(folder: Path) -> LedgerContent | None:
    """Return the content of a ledger whose scheduler is gone; None where there is none.

    Raises:
        RunError: it cannot be read, or is damaged.
    """
    journal = Journal(folder)
    try:
        return _recover(journal, folder)
    finally:
        journal.close()


def _recover(journal: Journal, folder: Path) -> LedgerContent | None:
    found = journal.recover()
    if found is None:
        return None
    try:
        base = codec.decode(found.base, expect=State).meta
        numbers = [_NUMBER.unpack_from(content)[0] for _, content in found.records]
    except (DecodeError, struct.error) as error:
        raise _failed(folder, f"is damaged: {error}") from error
    if base.pop("format", None) != FORMAT:
        raise _failed(folder, "was written by another version of zsdist")
    if numbers != list(range(len(numbers))):
        raise _failed(folder, "is damaged: an entry is missing")
    return LedgerContent(base, [(kind, content[_NUMBER.size :]) for kind, content in found.records])


def _failed(folder: Path, what: str) -> RunError:
    return RunError(f"scheduler's ledger {folder} {what}")


class Ledger:
    """Ledger of one start of a run, in a folder of its own. Each incarnation of the scheduler takes it over.

    Args:
        folder: folder of the ledger, created if missing.
        epoch: epoch of the scheduler.

    Raises:
        RunError: the folder cannot be written.
    """

    def __init__(self, folder: Path, epoch: int) -> None:
        self._folder = folder
        self._journal = Journal(folder)
        self._count = 0  # entries since the base
        self._holder, self._name = folder / "holder", str(epoch).encode()
        try:
            atomic_files.replace(self._holder, self._name)
        except OSError as error:
            raise _failed(self._folder, f"cannot be written: {error.strerror or error}") from error

    def recover(self) -> LedgerContent | None:
        """Return the content that a predecessor has left; None where there is none.

        Raises:
            RunError: it cannot be read, or is damaged.
        """
        content = _recover(self._journal, self._folder)
        self._count = 0 if content is None else len(content.entries)
        return content

    def require_newest(self) -> None:
        """Raise `RunError` where a successor has taken over the ledger: this process must not write any more."""
        try:
            holder = self._holder.read_bytes()
        except OSError as error:
            raise _failed(self._folder, f"cannot be read: {error.strerror or error}") from error
        if holder != self._name:
            raise _failed(self._folder, f"belongs to a successor, of epoch {holder.decode()}")

    def append(self, entries: Sequence[Record]) -> None:
        """Hand entries to the operating system in one write; what follows from them may be made known then.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        if not entries:
            return
        numbered = enumerate(entries, self._count)
        self._journal.append([(kind, _NUMBER.pack(number) + content) for number, (kind, content) in numbered])
        self._count += len(entries)

    @property
    def wants_base(self) -> bool:
        """True once there are so many entries that a `rebase` is due."""
        return self._journal.wants_base

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return self._journal.nbytes

    def rebase(self, base: dict[str, Any]) -> None:
        """Replace all entries by the state that follows from them.

        Raises:
            RunError: the disk is full, or the folder cannot be written.
        """
        self._journal.rebase(codec.encode(State("scheduler", base | {"format": FORMAT}, {})))
        self._count = 0
