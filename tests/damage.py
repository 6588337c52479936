"""Damage of a journal and of a checkpoint, one flipped bit at a time, and what is left of them.

    python tests/damage.py --flips 1000

Every row of the ring names itself in its state, and is compared whole with the row that was written. So a row that is
lost, doubled or changed is found. The last line is JSON.
"""

import argparse
import json
import random
import shutil
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from zsdist import config
from zsdist.config import parse
from zsdist.replay import journal, records
from zsdist.roles.replay import level_journal
from zsdist.roles.replay.level_journal import Entry
from zsdist.roles.replay.level_replay import LevelReplay
from zsdist.roles.replay.shards import ReplayShard
from zsdist.roles.shapes import Shape
from zsdist.run import checkpoint_files, directory
from zsdist.run.directory import RunDirectory
from zsdist.types import NO_GUIDE, Level, Trajectory
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire import codec
from zsdist.wire.messages import Push, State

FEATURES, ACTIONS, ACTORS = 3, 2, 3
COMPACT_RECORDS, PART_ROWS = 96, 32
CONFIG = parse({"replay": {"prioritised": True, "size_initial": 1000, "size_min": 100}})
Row = tuple[int, int, int]  # actor, frame, place in the frame


def frame(actor: int, number: int, produced: int, closes: bool = False, first: bool = False) -> Push:
    """Frame of one trajectory whose states name it; `produced` is the running total before it."""
    length = 1 + (5 * number + actor) % 7
    states = np.zeros((length + 1, FEATURES), np.float16)
    states[:, 0], states[:, 1], states[:, 2] = actor, number, np.arange(length + 1)
    made = Trajectory(
        Level.LOW,
        states,
        np.zeros(length, np.uint8),
        np.arange(length, dtype=np.float32) + number,
        np.full(length, 0.9, np.float32),
        np.arange(1, length + 1, dtype=np.uint16),
        np.ones((length + 1, ACTIONS), bool),
        np.full(length, NO_GUIDE, np.int8),
        np.zeros(length, np.uint8),
        number,
    )
    return Push(Level.LOW, f"actor-{actor}", 7, number, produced + length, closes, (made,), first)


def opened(folder: Path, settings: config.Config = CONFIG) -> LevelReplay:
    """Replay that has recovered from the journal in a folder."""
    made = LevelReplay(Level.LOW, Shape(FEATURES, ACTIONS), settings, ReplayShard.of(settings, 0), 1, folder)
    made.recover(None)
    return made


def filled(folder: Path, frames: int, settings: config.Config = CONFIG) -> tuple[LevelReplay, list[int]]:
    """Replay with so many frames of each actor in its journal, the last of which closes actor 0, and their totals."""
    made, totals = opened(folder, settings), [0] * ACTORS
    for actor in range(ACTORS):
        made.issue(f"actor-{actor}", 7)
    for number in range(frames):
        for actor in range(ACTORS):
            push = frame(actor, number, totals[actor], closes=actor == 0 and number == frames - 1)
            made.receive(push, codec.encode(push), float(number))
            totals[actor] = push.produced
        made.write_journal(float(number))
    return made, totals


def rows(replay: LevelReplay) -> dict[Row, bytes]:
    """All columns of each row of the ring, by its name."""
    ring = replay.buffer.rows_since(0)
    names = [tuple(int(value) for value in state) for state in ring["states"]]
    assert len(set(names)) == len(names), "a row is there twice"
    return {name: b"".join(ring[key][place].tobytes() for key in sorted(ring)) for place, name in enumerate(names)}


def rows_in(path: Path, at: int) -> set[Row]:
    """Names of the rows that a journal's file holds at an offset: those of a piece, or of one record of a log."""
    content, place = path.read_bytes(), 0
    for kind, record in records.read(content, content[:8], path).records if path.suffix in (".log", ".piece") else ():
        place += len(records.head(bytes(8), 0, 0, b"")) + len(record)
        if at < place:
            if path.suffix == ".piece":
                states = codec.decode(record, expect=State).arrays["states"]
                return {tuple(int(value) for value in state) for state in states}
            if kind != Entry.PUSH:
                return set()
            push = codec.decode(record, expect=Push)
            return {(int(push.actor[-1]), push.sequence, place) for place in range(push.count)}
    return set()


def flip(path: Path, bit: int) -> None:
    """Change one bit of a file."""
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def check_journal(before: Path, whole: dict[Row, bytes], totals: list[int], path: Path, bit: int, folder: Path) -> int:
    """Recover from a copy of a journal with one bit changed, check what is left, and return the number of lost rows."""
    expected = rows_in(path, bit // 8)
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(before, folder)
    flip(folder / path.name, bit)
    after = opened(folder)
    found = rows(after)
    assert set(whole) - set(found) == expected, "exactly the rows of the damaged record or piece are lost"
    assert all(whole[name] == row for name, row in found.items()), "a row has changed"
    after.buffer.check_valid()
    counts = after.counts()
    assert counts["produced"] == counts["stored"] + counts["rejected"] == sum(totals), counts
    assert counts["lost"] + counts["lost_rows"] == len(expected), counts
    assert any(path.name in line for line in after.news), "the damage is not reported"
    for actor, total in enumerate(totals):
        _, received, produced, closed = after.inbox.progress(f"actor-{actor}")
        assert (produced, closed) == (total, actor == 0), "an epoch waits for frames that never come again"
        if not closed:
            push = frame(actor, received, total)
            after.receive(push, codec.encode(push), 1e3)
            assert after.inbox.progress(f"actor-{actor}")[1:3] == (received + 1, push.produced)
    again = opened(folder)
    assert not again.news and rows(again) == found, "the damage is found a second time"
    return len(expected)


def checkpoints(folder: Path) -> Path:
    """Run directory with two checkpoints."""
    made = directory.create(folder, config.Config())
    files = RunDirectory(made, VisionIdentity("clip/b", "a" * 64, "head", "b" * 64))
    for count in (1, 2):
        arrays = {"ring": np.random.default_rng(count).random((40, 9))}
        learners = {f"learner-{level}": State(f"learner-{level}", {"updates": count}, arrays) for level in Level}
        scheduler = State("scheduler", {"finished": list(range(count))}, {})
        files.checkpoint(count, learners | {"scheduler": scheduler, "replay": State("replay", {}, arrays)})
    files.close()
    return made


def check_checkpoint(folder: Path, path: Path, bit: int) -> None:
    """Change one bit of the newest checkpoint; check that the one before is used, and the damaged file named."""
    flip(path, bit)
    lines: list[str] = []
    used, states, damaged = checkpoint_files.newest_whole(folder, lines.append)
    flip(path, bit)
    assert used.name == "00000001" and damaged == [path.parent] and states["learner-low"].meta["updates"] == 1
    assert len(lines) == 1 and f"checkpoint file {path} is damaged" in lines[0]


def main() -> None:
    """Flip bits at random places and print what it cost."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--flips", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, kinds, lost = random.Random(options.seed), Counter(), Counter()
    journal.COMPACT_RECORDS, level_journal.PART_ROWS = COMPACT_RECORDS, PART_ROWS
    with tempfile.TemporaryDirectory() as scratch:
        before, begun_s = Path(scratch, "before"), time.monotonic()
        made, totals = filled(before, 40)
        whole = rows(made)
        places = [(path, at) for path in sorted(before.iterdir()) for at in range(path.stat().st_size)]
        for _ in range(options.flips):
            path, at = rng.choice(places)
            cost = check_journal(before, whole, totals, path, 8 * at + rng.randrange(8), Path(scratch, "after"))
            kinds[path.suffix[1:]] += 1
            lost[path.suffix[1:]] += cost
        run = checkpoints(Path(scratch, "run"))
        newest = checkpoint_files.newest_checkpoint(run)
        places = [(path, at) for path in sorted(newest.iterdir()) for at in range(path.stat().st_size)]
        for _ in range(options.flips):
            path, at = rng.choice(places)
            check_checkpoint(run, path, 8 * at + rng.randrange(8))
        took_s = time.monotonic() - begun_s
    for kind, count in kinds.items():
        print(f"journal {kind}: {count} bits flipped, {lost[kind] / count:.1f} of {len(whole)} rows lost each")
    print(f"checkpoint: {options.flips} bits flipped, all found, the checkpoint before it used")
    print(json.dumps({"flips": options.flips, "journal": dict(kinds), "rows_lost": dict(lost), "took_s": took_s}))


if __name__ == "__main__":
    main()
