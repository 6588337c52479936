import threading

import numpy as np
import pytest

from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.replay import journal
from zsdist.roles.base import Context
from zsdist.roles.replay import role
from zsdist.roles.replay.role import Replay
from zsdist.roles.shapes import Shape
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import NO_GUIDE, Level, Trajectory
from zsdist.wire import codec, keys
from zsdist.wire.messages import Ack, Orders, Priorities, Push, SampleReply, SampleRequest, State

FEATURES, ACTIONS, RUN = 3, 2, "test"
CONFIG = parse({"low": {"min_size": 4, "updates_per_insert": 1.0}, "replay": {"batch_initial": 16}})
SHAPES = {Level.LOW: Shape(FEATURES, ACTIONS)}


def trajectory(first, length):
    states = np.full((length + 1, FEATURES), first, np.float32) + np.arange(length + 1)[:, None]
    masks = np.ones((length + 1, ACTIONS), bool)
    plain = {"actions": np.uint8, "rewards": np.float32, "discounts": np.float32, "behaviours": np.uint8}
    columns = {name: np.zeros(length, dtype) for name, dtype in plain.items()}
    successors, guides = np.arange(1, length + 1, dtype=np.uint16), np.full(length, NO_GUIDE, np.int8)
    return Trajectory(Level.LOW, states, successors=successors, masks=masks, guides=guides, weight_version=3, **columns)


class Bench:
    """Replay at a memory transport; the test plays all other roles at the other end."""

    def __init__(self, folder):
        self.folder, self.broker = folder, MemoryBroker()
        self.others = MemoryTransport(self.broker)
        self.acks, self.replies = Mailbox(2**20), Mailbox(2**24)
        self.others.subscribe(keys.ack(RUN, keys.ANY), self.acks)
        self.now = 0.0

    def begin(self, epoch=1, restored=None, config=CONFIG):
        context = Context(config, RUN, "replay", "0", epoch, MemoryTransport(self.broker), threading.Event())
        self.replay = Replay(context, SHAPES, self.folder, restored)
        return self.replay

    def issue(self, **epochs):
        content = {"epochs": epochs, "buffer_size": 2000, "batch_size": 16, "stop": False}
        self.others.publish(keys.control(RUN, "replay"), codec.encode(Orders(1, "replay", content)))

    def push(self, sequence, produced, *trajectories, actor="a", epoch=7):
        frame = Push(Level.LOW, actor, epoch, sequence, produced, False, trajectories)
        self.others.publish(keys.push(RUN, Level.LOW, actor, epoch), codec.encode(frame))

    def ask(self):
        request = codec.encode(SampleRequest(1, Level.LOW, 0))
        self.others.request(keys.sample(RUN, Level.LOW), request, self.replies, timeout_s=1.0)

    def step(self):
        self.now += 0.1
        self.replay.step(self.now)
        return [codec.decode(message.payload) for message in self.acks.drain()]


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path / "journal")
    bench.begin()
    bench.issue(a=7)
    bench.push(0, 5, trajectory(10, 5))
    bench.push(1, 8, trajectory(20, 3))
    bench.ask()
    bench.step()
    bench.step()
    return bench


def lasting(state: State):
    """Return the part of a state that a successor shares: all but the generator and the granted credit."""
    meta = {name: value for name, value in state.meta["low"].items() if name != "rng"}
    streams = {name: inserted for name, (inserted, _) in meta["limiter"]["streams"].items()}
    current = {actor: stream | {"granted": 0} for actor, stream in meta["inbox"]["current"].items()}
    return meta | {"limiter": meta["limiter"] | {"streams": streams}, "inbox": meta["inbox"] | {"current": current}}


def alike(one: State, other: State):
    assert lasting(one) == lasting(other)
    assert one.arrays.keys() == other.arrays.keys()
    for name, array in one.arrays.items():
        np.testing.assert_array_equal(array, other.arrays[name])


def test_a_successor_resumes_from_the_journal_of_a_dead_replay(bench):
    before = bench.replay.state()
    assert before.meta["low"]["stored"] == 8 and before.meta["low"]["sampled"] == 8
    after = bench.begin(epoch=2)
    alike(before, after.state())
    assert after.recovered == 2
    bench.push(1, 8, trajectory(20, 3))  # its acknowledgement may have been lost
    bench.push(2, 9, trajectory(30, 1))
    (ack,) = bench.step()
    assert (ack.sender_epoch, ack.received) == (2, 3)
    assert ack.credit > 9
    assert (
        after.level_replays[Level.LOW].counts()["stored"] == 9
        and after.level_replays[Level.LOW].counts()["duplicates"] == 1
    )


@pytest.mark.parametrize("capacity", [2000, 7])
@pytest.mark.parametrize("config", [CONFIG, parse({"replay": {"prioritised": True}})])
def test_a_compacted_journal_restores_the_ring_and_drops_rows_that_left_it(tmp_path, monkeypatch, capacity, config):
    monkeypatch.setattr(journal, "COMPACT_RECORDS", 3)
    bench = Bench(tmp_path / "journal")
    bench.begin(config=config)
    bench.issue(a=7)
    bench.replay.level_replays[Level.LOW].buffer.resize(capacity)
    for number in range(40):
        bench.push(number, 2 * number + 2, trajectory(number, 2))
        bench.step()
        bench.replay.level_replays[Level.LOW].resize(capacity, 16)  # as before, against the orders
        if number % 5 == 4:
            before = bench.replay.state()
            alike(before, bench.begin(epoch=number, config=config).state())
    pieces = list(tmp_path.glob("journal/low/*.piece"))
    assert len(pieces) > 10 if capacity == 2000 else 0 < len(pieces) < 5


@pytest.mark.parametrize("records", [1000, 1])
def test_an_early_frame_is_neither_acknowledged_early_nor_lost_later(bench, monkeypatch, records):
    monkeypatch.setattr(journal, "COMPACT_RECORDS", records)
    bench.push(3, 11, trajectory(50, 2))
    assert [ack.received for ack in bench.step() + bench.step()][-1] == 2
    monkeypatch.undo()
    bench.push(2, 9, trajectory(40, 1))
    bench.step()
    assert bench.step()[-1].received == 4
    before = bench.replay.state()
    alike(before, bench.begin(epoch=2).state())


def test_nothing_is_acknowledged_that_the_journal_does_not_hold(bench, monkeypatch):
    def full(*arguments):
        raise RunError("the disk is full")

    monkeypatch.setattr(bench.replay.level_replays[Level.LOW].journal, "write", full)
    bench.push(2, 9, trajectory(40, 1))
    with pytest.raises(RunError, match="disk is full"):
        bench.step()
    assert not [message for message in bench.acks.drain() if codec.decode(message.payload, expect=Ack).received == 3]


def test_refused_and_repeated_frames_are_not_written_into_the_journal(bench):
    size = bench.replay.statistics()["journal_bytes"]
    bench.push(0, 5, trajectory(10, 5))
    bench.push(0, 5, trajectory(10, 5), epoch=99)
    bench.push(0, 5, trajectory(10, 5), actor="stranger")
    bench.step()
    assert bench.replay.statistics()["journal_bytes"] == size
    assert bench.replay.level_replays[Level.LOW].inbox.refused.total() == 2


def test_a_resumed_run_begins_a_journal_from_its_checkpoint_and_accepts_new_epochs_only(bench, tmp_path):
    checkpoint = bench.replay.state()
    resumed = Bench(tmp_path / "another")
    resumed.begin(epoch=20, restored=checkpoint)
    resumed.issue(a=21)
    resumed.push(0, 4, trajectory(60, 4), epoch=21)
    resumed.step()
    counts = resumed.replay.level_replays[Level.LOW].counts()
    assert (counts["stored"], counts["produced"]) == (12, 12)
    assert resumed.replay.statistics()["low_size"] == 12


def ask_twice_for_five(bench):
    """Send two requests for 5 batches each, of 8 transitions, which allow an update each; one has been served."""
    bench.replies.drain()
    for _ in range(2):
        request = codec.encode(SampleRequest(1, Level.LOW, 1, batches=5))
        bench.others.request(keys.sample(RUN, Level.LOW), request, bench.replies, timeout_s=1.0)
    bench.step()


def batches_given(bench):
    replies = [codec.decode(message.payload, expect=SampleReply) for message in bench.replies.drain()]
    return [(reply.batches, len(reply.batch)) for reply in replies]


def test_requests_wait_until_there_is_enough_for_all(bench):
    ask_twice_for_five(bench)
    assert batches_given(bench) == []
    bench.push(2, 11, trajectory(30, 3))
    bench.step()
    assert batches_given(bench) == [(5, 55), (5, 55)]


def test_requests_that_waited_long_get_what_the_limiter_allows(bench):
    ask_twice_for_five(bench)
    while not (given := batches_given(bench)):
        bench.step()
    assert given == [(5, 40), (2, 16)]
    assert bench.now < 1.0
    assert bench.replay.statistics()["low_updates_served"] == 8
    assert bench.replay.level_replays[Level.LOW].counts()["sampled"] == 64


def test_requests_do_not_wait_once_actors_would_have_to_wait(tmp_path):
    bench = Bench(tmp_path / "journal")
    settings = {"min_size": 4, "updates_per_insert": 1 / 64}  # half of the band corresponds to two updates
    bench.begin(config=parse({"low": settings, "replay": {"batch_initial": 16}}))
    bench.issue(a=7)
    bench.push(0, 128, trajectory(0, 128))
    ask_twice_for_five(bench)
    assert batches_given(bench) == [(2, 2 * 16)]


def test_a_finished_run_leaves_no_journal(bench):
    content = {"epochs": {"a": 7}, "buffer_size": 2000, "batch_size": 16, "stop": True}
    bench.others.publish(keys.control(RUN, "replay"), codec.encode(Orders(1, "replay", content)))
    bench.step()
    assert not bench.folder.exists()


def test_batches_by_priority_follow_the_errors_that_the_learner_publishes(tmp_path):
    bench = Bench(tmp_path / "journal")
    settings = {"prioritised": True, "priority_exponent": 1.0, "batch_initial": 16}
    bench.begin(config=parse({"low": {"min_size": 4, "updates_per_insert": 9.0}, "replay": settings}))
    bench.issue(a=7)
    bench.push(0, 8, trajectory(10, 8))
    bench.ask()
    bench.step()
    (first,) = (codec.decode(message.payload, expect=SampleReply).batch for message in bench.replies.drain())
    assert (first.weights == 1.0).all()
    errors = np.where(first.states[:, 0] == 12, 100.0, 0.0).astype(np.float32)
    found = Priorities(1, Level.LOW, first.serials, errors)
    bench.others.publish(keys.priority(RUN, Level.LOW), codec.encode(found))
    bench.ask()
    bench.step()
    (second,) = (codec.decode(message.payload, expect=SampleReply).batch for message in bench.replies.drain())
    assert (second.states[:, 0] == 12).mean() > 0.9
    assert bench.replay.statistics()["low_prioritised"] == 8


def test_two_shards_store_and_acknowledge_the_transitions_of_their_own_actors_only(tmp_path):
    broker = MemoryBroker()
    others, boxes, acks = MemoryTransport(broker), [Mailbox(2**24), Mailbox(2**24)], Mailbox(2**20)
    others.subscribe(keys.ack(RUN, keys.ANY), acks)
    config = parse({"low": {"min_size": 4}, "replay": {"shards": 2}, "run": {"actors": 3}})
    shards = [
        Replay(Context(config, RUN, "replay", str(i), i, MemoryTransport(broker)), SHAPES, tmp_path / str(i))
        for i in (0, 1)
    ]
    content = {"epochs": {f"actor-{i}": 7 for i in range(3)}, "buffer_size": 3000, "batch_size": 16, "stop": False}
    others.publish(keys.control(RUN, "replay"), codec.encode(Orders(1, "replay", content)))
    for actor, length in enumerate((4, 5, 6)):
        frame = Push(Level.LOW, f"actor-{actor}", 7, 0, length, False, (trajectory(10 * actor, length),))
        others.publish(keys.push(RUN, Level.LOW, f"actor-{actor}", 7), codec.encode(frame))
    for index, box in enumerate(boxes):
        request = codec.encode(SampleRequest(1, Level.LOW, 0))
        others.request(keys.sample(RUN, Level.LOW, index), request, box, timeout_s=1.0)
    for now in (0.1, 0.2):
        for shard in shards:
            shard.step(now)
    assert [shard.statistics()["low_stored"] for shard in shards] == [10, 5]
    assert [shard.statistics()["low_capacity"] for shard in shards] == [2000, 1000]
    held = [codec.decode(message.payload, expect=SampleReply).held for box in boxes for message in box.drain()]
    assert held == [10, 5]
    received = [codec.decode(message.payload, expect=Ack) for message in acks.drain()]
    for index in (0, 1):
        assert {ack.actor for ack in received if ack.sender_epoch == index} == set(shards[index].shard.actors)


def test_an_actor_is_told_why_its_frame_cannot_be_read(bench):
    bench.others.publish(keys.push(RUN, Level.LOW, "a", 7), b"rubbish" * 9)
    bench.step()
    assert "magic" in [ack.refused for ack in bench.step() + bench.step() + bench.step()][-1]
    bench.push(2, 9, trajectory(30, 1))
    assert [ack.refused for ack in bench.step() + bench.step()][-1] == ""


def test_a_state_is_copied_in_slices_and_is_that_of_the_moment_of_the_request(bench, monkeypatch):
    monkeypatch.setattr(role, "COPY_BYTES", 1)
    answers = Mailbox(2**24)

    def request():
        asked = codec.encode(Orders(1, "replay", {"ask": "state"}))
        bench.others.request(keys.control(RUN, "replay"), asked, answers, timeout_s=1.0)

    request()
    bench.step()
    before, steps = bench.replay.state(), 0
    for number in range(2, 5):
        request()
        bench.push(number, 8 + 4 * (number - 1), trajectory(10 * number, 4))
    while not answers:
        bench.step()
        steps += 1
    assert steps > 4
    (first,) = (codec.decode(message.payload, expect=State) for message in answers.drain())
    alike(before, first)
    now = bench.replay.state()
    while not answers:
        bench.step()
    later = [codec.decode(message.payload, expect=State) for message in answers.drain()]
    assert len(later) == 3  # answered by one copy
    alike(now, later[0])
