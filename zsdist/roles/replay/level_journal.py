"""Journal of one level's replay: what its records and its base contain, and when they are written."""

import json
from collections.abc import Callable, Mapping
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from zsdist.replay import segments
from zsdist.replay.buffer import RingBuffer
from zsdist.replay.journal import Journal, Record
from zsdist.roles.replay.group_sync import GroupSync
from zsdist.types import Level
from zsdist.wire import codec
from zsdist.wire.frame import PLAIN
from zsdist.wire.messages import State

PART_ROWS = 128  # rows in a part of a piece, which are lost together where it is damaged
PACE_EVERY_S = 0.05  # largest age of the pace in a journal; its transitions are always complete

Head = tuple[int, int, int, bool]  # `Inbox.progress`


class Entry(IntEnum):
    """Kinds of records in the journal."""

    PUSH = 1  # a frame as it arrived, once all frames before it have arrived
    EPOCH = 2  # JSON: an actor and the epoch that was issued to it
    PACE = 3  # JSON: `LevelReplay.pace`
    HEADS = 4  # JSON: `Inbox.progress` of the actors whose frames come before it, should these be damaged


class Recovered(NamedTuple):
    """Content of a journal that a predecessor has left.

    Attributes:
        meta: first part of the state in its base.
        rows: ring in its base.
        lost: number of rows of that ring that are damaged.
        damage: lines about what is damaged.
        records: records since the base.
    """

    meta: dict[str, Any]
    rows: dict[str, np.ndarray]
    lost: int
    damage: list[str]
    records: list[Record]


class LevelJournal:
    """Journal of one level.

    Args:
        folder: folder of the journal, shared with its predecessors in this start of the run.
        level: level whose transitions it holds.
        fsync_ms: setting `replay.fsync_ms`.
    """

    def __init__(self, folder: Path, level: Level, fsync_ms: int | None) -> None:
        self._level = level
        self._journal = Journal(folder, synced=fsync_ms is not None)
        self._sync = GroupSync(fsync_ms)
        self._entries: list[Record] = []  # to be written before the next acknowledgement
        self._delivered: set[str] = set()  # actors with frames among the entries
        self._in_pieces = 0  # the pieces hold all rows of the ring that were written before this one
        self._pace: dict[str, int] = {}  # last one in the journal
        self._next_pace_s = 0.0

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return self._journal.nbytes

    @property
    def acknowledges_at(self) -> float:
        """Time from which on written frames may be acknowledged."""
        return self._sync.acknowledges_at

    @property
    def wants_base(self) -> bool:
        """True once it is long enough for `compact`."""
        return self._journal.wants_base

    def note_epoch(self, actor: str, epoch: int) -> None:
        """Note that an epoch was issued."""
        self._entries.append((Entry.EPOCH, json.dumps([actor, epoch]).encode()))

    def note_frame(self, actor: str, payload: bytes) -> None:
        """Note a frame that was delivered, as the bytes of its message."""
        self._entries.append((Entry.PUSH, payload))
        self.note_progress(actor)

    def note_progress(self, actor: str) -> None:
        """Note that an actor's frames have been delivered or skipped."""
        self._delivered.add(actor)

    def write(self, now: float, pace: Callable[[], dict[str, int]], progress: Callable[[str], Head]) -> None:
        """Write all that was noted, and sync it where that is due.

        Args:
            now: current time, seconds.
            pace: function that returns `LevelReplay.pace`.
            progress: function that returns `Inbox.progress` of an actor.
        """
        if now >= self._next_pace_s and (present := pace()) != self._pace:
            self._entries.append((Entry.PACE, json.dumps(present).encode()))
            self._pace, self._next_pace_s = present, now + PACE_EVERY_S
        if self._delivered:
            heads = [[actor, *progress(actor)] for actor in sorted(self._delivered)]
            self._entries.append((Entry.HEADS, json.dumps(heads).encode()))
        if self._entries:
            self._journal.append(self._entries)
            self._sync.note_records()
            self.forget()

    def sync(self, now: float) -> None:
        """Force what was written onto the disk, where that is due."""
        if self._sync.due(now):
            self._journal.sync()

    def forget(self) -> None:
        """Forget all that was noted: the journal has it."""
        self._entries = []
        self._delivered.clear()

    def compact(self, meta: Mapping[str, Any], ring: RingBuffer) -> None:
        """Replace the log: rows that it added become a piece, and all else goes into a new base.

        Args:
            meta: first part of the state, without the ring.
            ring: second part.
        """
        name = self._level.value
        base = State(name, {**meta, "held": len(ring)}, ring.layout())
        rows = ring.rows_since(self._in_pieces)
        count = len(rows["actions"])
        piece = []
        for at in range(0, count, PART_ROWS):
            part = {column: values[at : at + PART_ROWS] for column, values in rows.items()}
            piece.append(codec.encode(State(name, {"first": ring.written - count + at}, part), packing=PLAIN))
        self._journal.rebase(codec.encode(base), piece, end=ring.written, oldest=ring.written - len(ring))
        self._in_pieces = ring.written

    def recover(self, columns: Mapping[str, np.ndarray]) -> Recovered | None:
        """Return what a predecessor has left; None: there is no journal yet.

        Args:
            columns: all columns of a ring, without rows.
        """
        found = self._journal.recover()
        if found is None:
            return None
        base = codec.decode(found.base, expect=State)
        parts: list[tuple[int, Mapping[str, np.ndarray]]] = [(0, columns)]
        for piece in found.pieces:
            part = codec.decode(piece, expect=State)
            parts.append((part.meta["first"], part.arrays))
        rows, lost = segments.join(base.arrays, base.meta["held"], parts)
        # Where rows are lost, those that are left have new serials, and are written once more.
        self._in_pieces = 0 if lost else int(base.arrays["written"])
        damage = [str(place) for place in self._journal.damage]
        if lost:
            damage.append(f"{lost} of the {base.meta['held']} transitions of the ring are lost with it")
        return Recovered(base.meta, rows, lost, damage, found.records)

    def close(self) -> None:
        """Close the journal; closing again does nothing."""
        self._journal.close()
