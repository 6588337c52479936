"""Oracle of a run whose processes are killed: what was driven, journaled and acknowledged, against what is stored.

Three witnesses that know nothing of each other are compared with the last checkpoint: the files in which the cars count
their actions, the journals as they were read while they grew, and the acknowledgements as they passed the hub. Stored
transitions are compared by content: each must be there as often as it was journaled, and no other may be there.
"""

import hashlib
import threading
import time
from collections import Counter
from pathlib import Path

import numpy as np
from small_run import Launcher, Witness, actions

from zsdist.replay import records
from zsdist.roles.replay import shards
from zsdist.roles.replay.level_journal import Entry
from zsdist.run import checkpoint_files
from zsdist.types import Level
from zsdist.wire import codec
from zsdist.wire.messages import Push

POLL_S = 0.004
LOOK_EVERY_S = 0.1  # for journals of another start
Stream = tuple[str, str, int]  # level, actor, epoch


class Log:
    """Reader of the logs of one journal, which begins a new one at each compaction."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._base, self._file, self._at = folder, None, None, 0

    def pushes(self) -> list[Push]:
        """Return the frames since the last call."""
        bases = sorted(self._folder.glob("*.base"))  # a log counts once its base exists
        found = [] if self._file is None else self._read()  # to its end: it was complete before the next base
        if bases and bases[-1] != self._base:
            generation = int(bases[-1].stem)
            assert self._base is None or generation == int(self._base.stem) + 1, "a whole log was missed: too slow"
            file = bases[-1].with_suffix(".log").open("rb")
            if self._file is not None:
                self._file.close()
            self._base, self._file, self._at = bases[-1], file, 0
            found += self._read()
        return found

    def _read(self) -> list[Push]:
        """Return the new frames of the present log; an unfinished record at its end is read again later."""
        self._file.seek(self._at)
        content = self._file.read()
        found = records.read(content, content[: records.MARKER_BYTES], self._base)  # each record begins with the marker
        self._at += found.end
        return [codec.decode(record, expect=Push) for kind, record in found.records if kind == Entry.PUSH]


class Tail:
    """Reader of all journals of a run as they are written.

    Attributes:
        arrivals: time and epoch of each frame.
        totals: frames in order and transitions produced so far, of each stream.
        rows: digests of all transitions in the order in which they were written, by shard and level.
    """

    def __init__(self, folder: Path) -> None:
        self.arrivals: list[tuple[float, int]] = []
        self.totals: dict[Stream, tuple[int, int]] = {}
        self.rows: dict[tuple[str, str], list[bytes]] = {}
        self._early: dict[Stream, dict[int, Push]] = {}
        self._folder, self._logs, self._look_s = folder, {}, 0.0
        self._stop, self._lock = threading.Event(), threading.Lock()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Read the rest and stop."""
        self._stop.set()
        self._thread.join()
        self.read()

    def read(self) -> int:
        """Read what is written so far; return the total number of frames."""
        with self._lock:
            self._read()
            return len(self.arrivals)

    @property
    def last_s(self) -> float:
        """Time of the last frame."""
        if self._failure is not None:
            raise self._failure
        return self.arrivals[-1][0] if self.arrivals else 0.0

    def _follow(self) -> None:
        while not self._stop.is_set():
            try:
                self.read()
            except Exception as error:
                self._failure = error
                return
            time.sleep(POLL_S)

    def _read(self) -> None:
        if time.monotonic() >= self._look_s:
            self._look_s = time.monotonic() + LOOK_EVERY_S
            for level in Level:
                for folder in sorted(self._folder.glob(f"journal/*/{level.value}")):
                    self._logs.setdefault(folder, Log(folder))
        for folder, log in self._logs.items():
            try:
                pushes = log.pushes()
            except FileNotFoundError:  # compacted meanwhile; the next call finds the new one
                continue
            shard = shards.state_name(int(folder.parent.name.rpartition("-")[2]))
            for push in pushes:
                self._take(push, shard, time.time())

    def _take(self, push: Push, shard: str, now: float) -> None:
        self.arrivals.append((now, push.epoch))
        stream = (str(push.stream), push.actor, push.epoch)
        rows = self.rows.setdefault((shard, stream[0]), [])
        for trajectory in push.trajectories:
            rows += _digests_of(trajectory)
        early = self._early.setdefault(stream, {})
        early[push.sequence] = push
        frames, produced = self.totals.get(stream, (0, 0))
        while (frame := early.pop(frames, None)) is not None:
            frames, produced = frames + 1, frame.produced
        self.totals[stream] = frames, produced


def _digests_of(trajectory: object) -> list[bytes]:
    states = trajectory.states[: len(trajectory)]
    return _digests(states, trajectory.actions, trajectory.rewards, trajectory.discounts)


def _digests(states: np.ndarray, actions: np.ndarray, rewards: np.ndarray, discounts: np.ndarray) -> list[bytes]:
    """Return a digest of the content of each transition."""
    parts = (states.astype(np.float16), actions, rewards.astype(np.float32), discounts.astype(np.float32))
    columns = [np.ascontiguousarray(part).view(np.uint8).reshape(len(states), -1) for part in parts]
    return [hashlib.blake2b(row.tobytes(), digest_size=12).digest() for row in np.concatenate(columns, axis=1)]


def verdict(launcher: Launcher, tail: Tail, witness: Witness, summary: dict) -> dict:
    """Compare everything at the end of a run that was interrupted and saved.

    Returns:
        Counts by name. `lost`, `doubled`, `unbalanced`, `unaccounted` and `invented` must be 0:

        - `lost`: transitions that were acknowledged or journaled and are not stored;
        - `doubled`: transitions that are stored more often than they were journaled;
        - `unbalanced`: difference of the books, `produced - stored - rejected`, and of the books and the journals;
        - `unaccounted`: acknowledged frames that no journal held;
        - `invented`: transitions of an incarnation beyond the actions that its cars have driven.
    """
    states = checkpoint_files.read_checkpoint(checkpoint_files.checkpoints(launcher.folder)[-1])
    assert not any(counts["rejected"] for counts in summary["transitions"].values()), "transitions were rejected"
    lost = doubled = 0
    for (shard, level), written in tail.rows.items():
        ring = states[shard].part(f"{level}/")
        stored = Counter(_digests(ring["states"], ring["actions"], ring["rewards"], ring["discounts"]))
        expected = Counter(written[-int(ring["capacity"]) :])  # the newest, where the ring has turned over
        lost += (expected - stored).total()
        doubled += (stored - expected).total()
    unbalanced = 0
    for level, counts in summary["transitions"].items():
        written = sum(produced for stream, (_, produced) in tail.totals.items() if stream[0] == level)
        unbalanced += abs(written - counts["produced"])
        unbalanced += abs(counts["produced"] - counts["stored"] - counts["rejected"])
    transitions = [stream for stream in witness.acknowledged if stream[0] in tuple(Level)]
    driven = {who: actions(launcher.root / "steps", pid) for who, pid in witness.pids.items()}
    delivered = {who: tail.totals.get(("low", *who), (0, 0))[1] for who in driven}
    return {
        "lost": lost,
        "doubled": doubled,
        "unbalanced": unbalanced,
        "unaccounted": sum(
            max(0, witness.acknowledged[stream] - tail.totals.get(stream, (0, 0))[0]) for stream in transitions
        ),
        "invented": sum(max(0, delivered[who] - driven[who]) for who in driven),
        "driven": sum(driven.values()),
        "undelivered": sum(max(0, driven[who] - delivered[who]) for who in driven),
        "abandoned_at_most": sum(counts["abandoned_at_most"] for counts in summary["transitions"].values()),
        "produced": sum(counts["produced"] for counts in summary["transitions"].values()),
        "frames_acknowledged": sum(witness.acknowledged[stream] for stream in transitions),
    }


FAULTS = ("lost", "doubled", "unbalanced", "unaccounted", "invented")
COUNTS = (*FAULTS, "driven", "undelivered", "abandoned_at_most", "produced", "frames_acknowledged")
