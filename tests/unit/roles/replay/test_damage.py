"""Damaged journals: what is whole is kept, what is lost is counted once and reported, and every epoch goes on."""

import json
import random
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import damage
import numpy as np
import pytest
from damage import CONFIG, check_checkpoint, check_journal, checkpoints, filled, flip, frame, opened, rows

from zsdist.config import parse
from zsdist.replay import journal, records
from zsdist.roles.base import Context
from zsdist.roles.replay import level_journal
from zsdist.roles.replay.role import Replay
from zsdist.roles.shapes import Shape
from zsdist.run import checkpoint_files
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "journal"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(journal, "COMPACT_RECORDS", damage.COMPACT_RECORDS)
        patch.setattr(level_journal, "PART_ROWS", damage.PART_ROWS)
        replay, totals = filled(folder, 40)
        return folder, rows(replay), totals


@pytest.mark.parametrize("kind", ["log", "log", "piece", "base", "copy"])
@pytest.mark.parametrize("seed", range(6))
def test_a_flipped_bit_anywhere_in_a_journal_costs_what_it_hit_and_nothing_else(made, tmp_path, kind, seed):
    folder, whole, totals = made
    rng = random.Random(f"{kind} {seed}")
    path = rng.choice(sorted(folder.glob(f"*.{kind}")))
    check_journal(folder, whole, totals, path, rng.randrange(8 * path.stat().st_size), tmp_path / "after")


def test_a_flipped_bit_anywhere_in_a_checkpoint_is_found_and_named(tmp_path):
    run, rng = checkpoints(tmp_path / "run"), random.Random(0)
    for path in sorted(checkpoint_files.newest_checkpoint(run).iterdir()):
        for _ in range(6):
            check_checkpoint(run, path, rng.randrange(8 * path.stat().st_size))


@pytest.mark.parametrize("seed", range(10))
def test_a_zeroed_block_of_the_log_leaves_books_that_balance(made, tmp_path, seed):
    folder, whole, totals = made
    shutil.copytree(folder, tmp_path / "after")
    (log,) = (tmp_path / "after").glob("*.log")
    content, rng = bytearray(log.read_bytes()), random.Random(seed)
    start = rng.randrange(len(content) // 2)
    content[start : start + 1024] = bytes(len(content[start : start + 1024]))
    log.write_bytes(content)
    after = opened(tmp_path / "after")
    found, counts = rows(after), after.counts()
    assert found.items() <= whole.items() and after.news
    assert counts["produced"] == counts["stored"] + counts["rejected"] == sum(totals)
    assert counts["lost"] == len(whole) - len(found) > 0


def cut_log(folder, keep):
    """Cut a log behind so many records, as a machine does that loses power."""
    (log,) = folder.glob("*.log")
    content = log.read_bytes()
    found = records.read(content, content[:8], log)
    log.write_bytes(
        content[: sum(len(records.head(bytes(8), 0, 0, record)) + len(record) for _, record in found.records[:keep])]
    )


def test_frames_that_were_acknowledged_and_are_gone_are_bridged_once_their_sender_says_so(tmp_path):
    _, totals = filled(tmp_path / "journal", 6)
    cut_log(tmp_path / "journal", 3 + 4)  # epochs, and the first of six rounds: one frame of each actor, and the heads
    after = opened(tmp_path / "journal")
    assert after.inbox.progress("actor-1")[1] == 1
    late = frame(1, 7, totals[1] + frame(1, 6, 0).count)
    after.receive(late, codec.encode(late), 1.0)
    assert after.inbox.progress("actor-1")[1] == 1, "frame 6 may still come"
    push = frame(1, 6, totals[1], first=True)
    after.receive(push, codec.encode(push), 1.0)
    assert after.inbox.progress("actor-1")[1:3] == (8, late.produced)
    lost = totals[1] - frame(1, 0, 0).count
    assert after.counts()["lost"] == after.counts()["rejected"] == lost
    assert any(f"{lost} acknowledged transitions of actor-1 are lost" in line for line in after.news)
    for number in (3, 6):  # by chance
        again = frame(1, number, 0)
        after.receive(again, codec.encode(again), 1.0)
    assert after.counts()["duplicates"] == 2 and after.counts()["lost"] == lost
    after.write_journal(9.0)
    successor = opened(tmp_path / "journal")
    assert successor.counts()["lost"] == lost
    assert successor.inbox.progress("actor-1") == after.inbox.progress("actor-1")
    books = successor.counts()
    assert books["produced"] == books["stored"] + books["rejected"]


def test_a_ring_without_the_rows_of_a_piece_samples_the_others_by_priority(made, tmp_path):
    folder, whole, _ = made
    shutil.copytree(folder, tmp_path / "after")
    flip(min((tmp_path / "after").glob("*.piece")), 999)
    after = opened(tmp_path / "after")
    assert 0 < after.counts()["lost_rows"] == len(whole) - len(after.buffer)
    batch = after.buffer.sample(np.random.default_rng(0), 64)
    assert {tuple(map(int, state)) for state in batch.states} <= set(rows(after))
    old = np.arange(len(whole))
    assert after.buffer.update_priorities(old, np.ones(len(old), np.float32)) == 0, "serials of before name no row"
    assert after.buffer.update_priorities(batch.serials, np.ones(64, np.float32)) == 64


class Bench:
    """Replay role at a memory transport, and what others hear of it."""

    def __init__(self, folder, **replay):
        broker, self.config = MemoryBroker(), parse({"replay": CONFIG.replay.model_dump() | replay})
        self.others, self.acks, self.events = MemoryTransport(broker), Mailbox(2**20), Mailbox(2**20)
        self.others.subscribe(keys.ack("test", keys.ANY), self.acks)
        self.others.subscribe(keys.events("test"), self.events)
        context = Context(self.config, "test", "replay", "0", 1, MemoryTransport(broker), threading.Event())
        self.role = Replay(context, {Level.LOW: Shape(damage.FEATURES, damage.ACTIONS)}, folder)
        orders = {"epochs": {"actor-0": 7}, "buffer_size": 1000, "batch_size": 16, "stop": False}
        self.others.publish(keys.control("test", "replay"), codec.encode(Orders(1, "replay", orders)))
        self.produced = self.sequence = 0

    def push(self):
        made = frame(0, self.sequence, self.produced)
        self.produced, self.sequence = made.produced, self.sequence + 1
        self.others.publish(keys.push("test", Level.LOW, "actor-0", 7), codec.encode(made))

    def step(self, now):
        """Take a step; return its next time and the number of frames that were acknowledged in it."""
        wake_s = self.role.step(now)
        received = [codec.decode(message.payload).received for message in self.acks.drain()]
        return wake_s, received[-1] if received else None


@pytest.mark.parametrize(
    ("fsync_ms", "syncs", "acknowledged"),
    [(None, [], [1, 2, 3]), (0, [1, 2, 3], [1, 2, 3]), (100, [1, 3], [1, None, 3])],
)
def test_a_frame_is_acknowledged_once_it_is_on_the_disk(tmp_path, monkeypatch, fsync_ms, syncs, acknowledged):
    bench, synced, heard = Bench(tmp_path / "journal", fsync_ms=fsync_ms), [], []
    bench.step(0.0)
    monkeypatch.setattr(journal.os, "fdatasync", lambda file: synced.append(bench.sequence))
    for now in (1.0, 1.04, 1.08):
        bench.push()
        wake_s, at_once = bench.step(now)
        assert wake_s <= (1.1 if fsync_ms and now > 1.0 else now + 0.25)
        heard.append(bench.step(now + 0.03)[1] or at_once)  # a little later than `ACK_AFTER_S`
    assert (synced, heard) == (syncs, acknowledged)


def test_damage_is_an_event_a_line_in_the_log_and_a_figure(tmp_path, capsys):
    bench = Bench(tmp_path / "journal")
    for now in range(4):
        bench.push()
        bench.step(float(now))
    (log,) = (tmp_path / "journal").glob("*/*.log")
    flip(log, 8 * (log.stat().st_size // 3))
    after = Bench(tmp_path / "journal")
    after.step(10.0)
    (event,) = [json.loads(message.payload) for message in after.events.drain()]
    assert event["event"] == "journal_damaged" and f"{log} is damaged" in event["what"]
    assert f"replay: low level: {log} is damaged" in capsys.readouterr().err
    assert after.role.statistics()["low_lost"] == after.role.statistics()["low_rejected"] > 0
    after.step(11.0)
    assert not after.events.drain(), "once"


SMALL_DISK = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from damage import checkpoints, filled
from zsdist.errors import RunError
from zsdist.replay import journal
from zsdist.run import checkpoint_files
folder = Path(sys.argv[1])
run = checkpoints(folder / "run")
try:
    journal.COMPACT_RECORDS = 10**9
    filled(folder / "journal", 10_000)
except RunError as error:
    print(error)
try:
    from zsdist.run.directory import RunDirectory
    states = checkpoint_files.read_checkpoint(checkpoint_files.newest_checkpoint(run))
    vision = checkpoint_files.read_vision(checkpoint_files.newest_checkpoint(run))
    RunDirectory(run, vision).checkpoint(3, states)
except RunError as error:
    print(error)
print(checkpoint_files.newest_whole(run)[0].name)
"""


def test_a_full_disk_ends_in_one_line_with_the_last_checkpoint_whole(tmp_path):
    mounted = ["unshare", "-rm", "sh", "-c", 'mount -t tmpfs -o size=256k tmpfs "$0" && exec "$@"', str(tmp_path)]
    if shutil.which("unshare") is None or subprocess.run([*mounted, "true"], capture_output=True).returncode:
        pytest.skip("this machine lets no user mount a small file system")
    tests = str(Path(damage.__file__).parent)
    command = [*mounted, sys.executable, "-c", SMALL_DISK, str(tmp_path), tests]
    told = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert told.stderr == "" and told.returncode == 0, told.stderr
    journal_line, checkpoint_line, newest = told.stdout.splitlines()
    assert journal_line.startswith(f"replay journal {tmp_path}/journal cannot be written: ")
    assert "No space left on device" in checkpoint_line and newest == "00000002"
