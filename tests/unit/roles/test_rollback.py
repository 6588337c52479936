import dataclasses
import errno
import json
import os

import numpy as np
import pytest

from zsdist.config import parse
from zsdist.dqn import batches
from zsdist.dqn.fused import FusedDqnLearner
from zsdist.dqn.soundness import UnsoundUpdateError
from zsdist.errors import RunError
from zsdist.roles import rollback
from zsdist.roles.base import Context
from zsdist.roles.learner import Learner
from zsdist.roles.rollback import ALLOWED, FILES_KEPT, Rollbacks, read_update
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level, StoredBatch
from zsdist.wire import codec, keys
from zsdist.wire.messages import SampleReply, WeightsMessage

FEATURES, ACTIONS, RUN = 3, 2, "test"
LOW = {"reward_scale": 1e4, "hidden": [8]}
CONFIG = parse({"low": LOW, "run": {"actors": 1}})
RNG = np.random.default_rng(0)


def batch(reward=0.0, rows=4):
    return StoredBatch(
        states=RNG.normal(size=(rows, FEATURES)).astype(np.float16),
        actions=RNG.integers(0, ACTIONS, rows).astype(np.uint8),
        rewards=np.full(rows, reward, np.float32),
        discounts=np.zeros(rows, np.float32),
        next_states=RNG.normal(size=(rows, FEATURES)).astype(np.float16),
        next_masks=np.ones((rows, ACTIONS), bool),
        masks=np.ones((rows, ACTIONS), bool),
        guides=np.full(rows, -1, np.int8),
    )


SPOILS = 1e38  # a reward that is infinite once it is scaled
GOOD, BAD = batches.from_stored(batch()), batches.from_stored(batch(SPOILS))


class Bench:
    """Learner at a memory transport; the test plays the replay and watches events and weights."""

    def __init__(self, refused):
        broker, self.now = MemoryBroker(), 0.0
        self.others = MemoryTransport(broker)
        self.requests, self.weights, self.told = Mailbox(2**20), Mailbox(2**24), Mailbox(2**20)
        self.others.serve(keys.sample(RUN, Level.LOW, 0), self.requests)
        self.others.subscribe(keys.weights(RUN, Level.LOW), self.weights)
        self.others.subscribe(keys.events(RUN), self.told)
        context = Context(CONFIG, RUN, "learner", "low", 1, MemoryTransport(broker))
        self.learner = Learner(context, Level.LOW, make_dqn(), refused=refused)
        self.step()

    def step(self):
        self.now += 3.0
        self.learner.step(self.now)

    def feed(self, *drawn):
        """Answer one request with batches, and let the learner work."""
        rows = {field.name: [getattr(one, field.name) for one in drawn] for field in dataclasses.fields(drawn[0])}
        joined = {name: None if parts[0] is None else np.concatenate(parts) for name, parts in rows.items()}
        reply = SampleReply(Level.LOW, dataclasses.replace(drawn[0], **joined), 100, 0.0, len(drawn))
        self.requests.drain()[0].reply(codec.encode(reply))
        self.step()

    def events(self):
        return [json.loads(message.payload) for message in self.told.drain()]

    def published(self):
        return [codec.decode(message.payload, expect=WeightsMessage) for message in self.weights.drain()]


def make_dqn(config=CONFIG, level=Level.LOW):
    return FusedDqnLearner(FEATURES, ACTIONS, config.low, seed=0)


def refuse(rollbacks, dqn, updates=7):
    with pytest.raises(UnsoundUpdateError) as refused:
        dqn.update(BAD)
    return rollbacks.explain(refused.value, BAD, updates)


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path / "nan")


def test_a_batch_that_spoils_is_skipped_and_the_learner_goes_on_from_its_last_sound_state(bench, tmp_path):
    bench.feed(batch(), batch(SPOILS), batch())
    assert bench.learner.updates == 2
    assert bench.learner.statistics()["rollbacks"] == 1
    (event,) = bench.events()
    assert (event["event"], event["level"], event["update"]) == ("rolled_back", "low", 1)
    assert "first in scaled rewards of the batch: inf at [0], 4 of 4 numbers" in event["found"]
    (file,) = (tmp_path / "nan").iterdir()
    assert f"-m zsdist.doctor --replay-update {file}" in event["found"]
    published = bench.published()
    assert published[-1].weights.version == bench.learner.version > 1
    assert all(np.isfinite(array).all() for array in published[-1].weights.parameters.values())


def test_the_run_ends_when_going_back_has_not_helped_three_times(bench):
    for _ in range(ALLOWED):
        bench.feed(batch(SPOILS))
    with pytest.raises(RunError, match=r"diverged at update 0, .*went back to a sound state 3 times before.*--set low"):
        bench.feed(batch(SPOILS))
    assert [event["event"] for event in bench.events()] == ["rolled_back"] * ALLOWED + ["diverged"]


def test_spoilt_weights_are_replaced_by_sound_ones_before_they_are_published_or_saved(bench):
    sound = bench.learner.dqn.state()
    for use in (bench.learner.state, bench.step):
        spoilt = sound | {"online/output.bias": np.full(ACTIONS, np.nan, np.float32)}
        bench.learner.dqn.restore(spoilt, check=False)
        use()
        assert np.array_equal(bench.learner.dqn.parameters()["output.bias"], sound["online/output.bias"])
    assert all(np.isfinite(message.weights.parameters["output.bias"]).all() for message in bench.published())
    assert [event["found"] for event in bench.events()] == [
        "its state holds a number that is not finite, in online/output.bias",
        "its network holds a number that is not finite, in output.bias",
    ]


def test_a_disk_that_takes_no_file_is_reported_and_stops_no_learning(tmp_path):
    (tmp_path / "nan").touch()
    bench = Bench(tmp_path / "nan")
    bench.feed(batch(SPOILS), batch())
    assert bench.learner.updates == 1
    (event,) = bench.events()
    assert "the update cannot be written to" in event["found"] and os.strerror(errno.EEXIST) in event["found"]


def test_the_file_of_a_refused_update_makes_it_again(tmp_path):
    dqn = make_dqn()
    dqn.update(GOOD)
    before = dqn.state()
    told = refuse(Rollbacks(dqn, CONFIG, Level.LOW, tmp_path), dqn)
    (file,) = tmp_path.iterdir()
    update = read_update(file, make_dqn)
    assert (update.level, update.number, update.config) == (Level.LOW, 8, CONFIG)
    found = update.dqn.state()
    assert all(np.array_equal(array, found[name]) for name, array in before.items())
    assert update.dqn.examine(update.batch) in told
    with pytest.raises(UnsoundUpdateError):
        update.dqn.update(update.batch)


def test_only_the_newest_files_are_kept(tmp_path):
    dqn = make_dqn()
    rollbacks = Rollbacks(dqn, CONFIG, Level.LOW, tmp_path)
    for updates in range(FILES_KEPT + 3):
        refuse(rollbacks, dqn, updates)
    assert len(list(tmp_path.iterdir())) == FILES_KEPT


@pytest.mark.parametrize("content", [b"", b"nothing of ours", codec.encode(SampleReply(Level.LOW, None, 1, 0.0))])
def test_a_file_that_holds_no_update_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(RunError, match=f"update {tmp_path / 'file'} holds no update of a learner"):
        read_update(tmp_path / "file", make_dqn)
    with pytest.raises(RunError, match="cannot be read: No such file"):
        read_update(tmp_path / "other", make_dqn)


def test_the_state_that_is_restored_is_the_last_one_that_was_kept(monkeypatch):
    monkeypatch.setattr(rollback, "KEPT_EVERY", 5)
    dqn = make_dqn()
    rollbacks = Rollbacks(dqn, CONFIG, Level.LOW, None)
    states = [dqn.state()]
    for _ in range(13):
        dqn.update(GOOD)
        assert rollbacks.note_update() is None
        states.append(dqn.state())
    rollbacks.go_back("found", 13, 1)
    found = dqn.state()
    assert all(np.array_equal(array, found[name]) for name, array in states[10].items())


def test_earlier_rollbacks_are_forgiven_after_many_sound_updates_and_only_then(monkeypatch):
    monkeypatch.setattr(rollback, "FORGIVEN_AFTER", 3)
    rollbacks = Rollbacks(make_dqn(), CONFIG, Level.LOW, None)
    for sound_updates in (0, 2, 2, 3, 0, 0):
        for _ in range(sound_updates):
            rollbacks.note_update()
        rollbacks.go_back("found", 1, 1)
    assert rollbacks.count == 2 * ALLOWED
    for _ in range(2):
        rollbacks.note_update()
    with pytest.raises(RunError, match="3 times before"):
        rollbacks.go_back("found", 1, 1)
