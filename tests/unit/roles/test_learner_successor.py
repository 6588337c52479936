"""Learner that died, and its successor: what it knew, offered and published is there, and nothing is used twice."""

import json
import threading

import numpy as np
import pytest
from learner_batches import same_arrays
from mailboxes import REPLAY, RUN
from storm import trajectory

from zsdist.config import LevelConfig, parse
from zsdist.dqn.learner import DqnLearner
from zsdist.roles.base import Context
from zsdist.roles.kept_state import KEEP_AFTER_S
from zsdist.roles.replay.role import Replay
from zsdist.roles.shapes import Shape
from zsdist.run import learners
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level, StoredBatch
from zsdist.wire import codec, keys
from zsdist.wire.messages import Candidate, Orders, Push, SampleReply, SampleRequest, WeightsMessage

FEATURES, ACTIONS = 4, 3


def batch(rng, rows):
    return StoredBatch(
        states=rng.normal(size=(rows, FEATURES)).astype(np.float16),
        actions=rng.integers(0, ACTIONS, rows).astype(np.uint8),
        rewards=rng.normal(size=rows).astype(np.float32),
        discounts=np.full(rows, 0.9, np.float32),
        next_states=rng.normal(size=(rows, FEATURES)).astype(np.float16),
        next_masks=np.ones((rows, ACTIONS), bool),
        masks=np.ones((rows, ACTIONS), bool),
        guides=rng.integers(-1, ACTIONS, rows).astype(np.int8),
    )


def merge_orders(merge, chosen="", driven=0):
    candidates = ["recent", "distilled", "best"] if merge > 1 else ["recent", "distilled"]
    orders = {"learning": True, "merge": merge, "driven": driven, "candidates": candidates}
    return orders | {"chosen": chosen, "stop": False}


LEARNS = merge_orders(0) | {"candidates": []}


class Life:
    """Learners of one level, one after another; the test plays the replay and the scheduler."""

    def __init__(self, folder):
        self.folder, self.rng, self.now, self.epoch = folder, np.random.default_rng(0), 0.0, 0
        self.broker = MemoryBroker()
        self.others = MemoryTransport(self.broker)
        self.requests, self.published, self.events = Mailbox(2**20), Mailbox(2**26), Mailbox(2**20)
        self.others.serve(keys.sample(RUN, Level.LOW), self.requests)
        self.others.subscribe(keys.weights(RUN, Level.LOW), self.published)
        self.others.subscribe(keys.candidate(RUN, Level.LOW, keys.ANY), self.published)
        self.others.subscribe(keys.events(RUN), self.events)
        self.begin()

    def begin(self):
        self.epoch += 1
        context = Context(parse({}), RUN, "learner", "low", self.epoch, MemoryTransport(self.broker), threading.Event())
        dqn = DqnLearner(FEATURES, ACTIONS, LevelConfig(hidden=(8,)), seed=0)
        self.learner = learners.resumed(context, Level.LOW, dqn, None, folder=self.folder, start="s")

    def kill(self):
        """Kill the learner; return its successor."""
        self.learner.transport.close()
        self.requests.drain()
        self.begin()
        return self.learner

    def order(self, content):
        self.others.publish(keys.control(RUN, "learner"), codec.encode(Orders(1, "learner", content)), retained=True)
        self.step()

    def step(self, seconds=0.1):
        self.now += seconds
        self.learner.step(self.now)

    def learn(self, steps=3):
        for _ in range(steps):
            for request in self.requests.drain():
                batches = codec.decode(request.payload, expect=SampleRequest).batches
                rows = batch(self.rng, rows=4 * batches)
                request.reply(codec.encode(SampleReply(Level.LOW, rows, 100, 0.0, batches)))
            self.step()

    def sent(self, kind):
        return [message for item in self.published.drain() if isinstance(message := codec.decode(item.payload), kind)]

    def event_names(self):
        return [json.loads(message.payload)["event"] for message in self.events.drain()]


@pytest.fixture
def life(tmp_path):
    return Life(tmp_path)


def test_a_successor_continues_bit_for_bit_from_a_state_that_is_seconds_old(life):
    life.order(LEARNS)
    life.learn(40)
    life.step(KEEP_AFTER_S)
    before = life.learner.state()
    after = life.kill().state()
    assert before.meta["updates"] == after.meta["updates"] > 0
    assert same_arrays(before.arrays, after.arrays)
    assert after.meta["learned"] == [after.meta["updates"]]


def test_no_version_of_weights_is_published_twice(life):
    life.order(LEARNS)
    last = 0
    for _ in range(6):
        life.learn(30)
        versions = [message.weights.version for message in life.sent(WeightsMessage)]
        assert min(versions) > last
        last = max(versions)
        life.kill()
        assert life.learner.version == last
        life.step()


def test_before_it_has_kept_anything_its_successor_begins_anew_and_beyond_its_versions(life):
    life.step()
    (first,) = life.sent(WeightsMessage)
    life.kill()
    life.step()
    (second,) = life.sent(WeightsMessage)
    assert second.weights.version == first.weights.version + 1
    assert second.sender_epoch > first.sender_epoch
    assert same_arrays(first.weights.parameters, second.weights.parameters)


def networks(offers):
    """Parameters by merge and name of candidate; asserts that there is only one network of each."""
    found = {}
    for offer in offers:
        earlier = found.setdefault((offer.merge, offer.name), offer.parameters)
        assert same_arrays(earlier, offer.parameters), f"two networks are called {offer.name}"
    return found


def differences(one, other):
    return {name: one[name] - other[name] for name in one}


@pytest.mark.parametrize("killed_in", ["offering", "driving", "training", "promoted", "never"])
@pytest.mark.parametrize("chosen", ["recent", "distilled"])
def test_a_merge_goes_on_with_the_same_candidates_and_with_what_was_learned_meanwhile(life, killed_in, chosen):
    life.order(LEARNS)
    life.learn(20)
    life.order(merge_orders(1))
    if killed_in == "offering":
        life.kill()
    life.step()
    life.order(merge_orders(1, driven=1))
    if killed_in == "driving":
        life.kill()
    life.learn(20)
    life.step(3.0)
    offers = networks(life.sent(Candidate))
    assert set(offers) == {(1, "recent"), (1, "distilled")}
    if killed_in == "training":
        life.kill()
    learned = differences(life.learner.dqn.parameters(), offers[1, "recent"])
    assert any(change.any() for change in learned.values())
    life.requests.drain()
    life.order(merge_orders(1, chosen, driven=12))
    promoted = life.learner.dqn.target_parameters()
    if killed_in == "promoted":
        life.kill()
    life.order(merge_orders(1, chosen, driven=12))  # is repeated
    assert life.learner.merge == 1
    assert same_arrays(life.learner.dqn.target_parameters(), promoted)
    assert same_arrays(life.learner.dqn.parameters(), promoted)
    kept = differences(promoted, offers[1, chosen])
    assert all(np.allclose(kept[name], learned[name], atol=1e-6) for name in kept)
    assert max(message.merge for message in life.sent(WeightsMessage)) == 1
    life.order(merge_orders(2))
    assert same_arrays(networks(life.sent(Candidate))[2, "best"], offers[1, chosen])
    assert life.event_names() in ([], ["distilled_is_recent"])  # after a promotion by a successor


def test_where_the_last_winner_wins_again_what_was_learned_meanwhile_is_dropped(life):
    life.order(LEARNS)
    life.learn(20)
    life.order(merge_orders(1))
    life.order(merge_orders(1, "recent"))
    life.learn(20)
    life.order(merge_orders(2))
    life.learn(20)
    best = networks(life.sent(Candidate))[2, "best"]
    life.requests.drain()
    for _ in range(3):
        life.step()  # until no batch is left
    life.order(merge_orders(2, "best"))
    assert same_arrays(life.learner.dqn.parameters(), best)
    assert same_arrays(life.learner.dqn.target_parameters(), best)


@pytest.mark.parametrize("chosen", ["recent", "distilled"])
def test_the_winner_is_promoted_bit_for_bit_where_nothing_was_learned_meanwhile(life, chosen):
    life.order(LEARNS)
    life.learn(20)
    life.order(merge_orders(1) | {"learning": False})
    life.learn(5)
    offers = networks(life.sent(Candidate))
    life.order(merge_orders(1, chosen) | {"learning": False})
    assert same_arrays(life.learner.dqn.parameters(), offers[1, chosen])
    assert same_arrays(life.learner.dqn.target_parameters(), offers[1, chosen])


def test_a_successor_makes_no_update_in_the_last_merge_of_a_run(life):
    life.order(LEARNS)
    life.learn(20)
    life.order(merge_orders(1) | {"learning": False})
    before = life.learner.updates
    life.others.kept.clear()  # the orders are on their way
    life.kill()
    life.learn(5)
    assert life.learner.updates == before
    life.order(LEARNS | {"merge": 1})
    life.learn(5)
    assert life.learner.updates > before


def test_damage_is_said_and_the_run_goes_on_even_in_a_merge(life):
    life.order(LEARNS)
    life.learn(20)
    life.order(merge_orders(1))
    life.order(merge_orders(1, driven=1))
    published = max(message.weights.version for message in life.sent(WeightsMessage))
    for path in life.folder.glob("journal/*/*.state"):
        path.write_bytes(path.read_bytes()[:-1])
    life.kill()
    life.step(0.0)
    assert life.learner.updates == 0  # there is no checkpoint
    assert life.learner.version > published
    assert life.event_names() == ["kept_state_damaged", "candidates_made_again", "distilled_is_recent"]
    life.order(merge_orders(1, "distilled", driven=12))
    assert life.learner.merge == 1


def test_nothing_is_left_at_the_end(life):
    life.order(LEARNS)
    life.learn(5)
    life.order(LEARNS | {"stop": True, "learning": False})
    assert life.learner.finished
    assert not list(life.folder.rglob("*.state"))


class Pace:
    """Replay with a certain number of rows, and learners that ask it for batches."""

    def __init__(self, folder):
        self.broker, self.now, self.epoch, self.folder = MemoryBroker(), 0.0, 10, folder
        self.others, self.answers = MemoryTransport(self.broker), Mailbox(2**24)
        self.config = parse({"low": {"min_size": 8, "updates_per_insert": 0.5}})
        self.begin()

    def begin(self):
        self.epoch += 1
        context = Context(self.config, RUN, "replay", "0", self.epoch, MemoryTransport(self.broker), threading.Event())
        self.replay = Replay(context, {Level.LOW: Shape(FEATURES, ACTIONS)}, self.folder)
        self.level = self.replay.level_replays[Level.LOW]

    def step(self):
        self.now += 0.1
        self.replay.step(self.now)

    def ask(self, epoch, updates, batches=4):
        """Ask for batches as a learner; return how many came."""
        request = codec.encode(SampleRequest(epoch, Level.LOW, updates, batches))
        self.others.request(keys.sample(RUN, Level.LOW), request, self.answers, timeout_s=1.0)
        for _ in range(5):
            self.step()
        replies = [codec.decode(message.payload, expect=SampleReply) for message in self.answers.drain()]
        return sum(reply.batches for reply in replies if reply.batch is not None)


def filled(pace, rows):
    pace.others.publish(keys.control(RUN, "replay"), codec.encode(Orders(1, "replay", REPLAY)), retained=True)
    pace.step()
    push = Push(Level.LOW, "actor-0", 7, 0, rows, False, (trajectory(0, 7, 0, rows),))
    pace.others.publish(keys.push(RUN, Level.LOW, "actor-0", 7), codec.encode(push))
    pace.step()
    assert pace.level.stored == rows
    return pace


@pytest.fixture
def pace(tmp_path):
    return filled(Pace(tmp_path / "journal"), 60)


def test_batches_that_died_with_a_learner_are_given_to_its_successor(pace):
    assert [pace.ask(20, updates) for updates in (0, 4, 8)] == [4, 4, 4]
    assert pace.level.limiter.updates == 12
    assert pace.ask(21, 5) == 4  # of 12 its successor knows 5
    assert pace.level.limiter.updates == 5 + 4
    served = 9
    while given := pace.ask(21, served):
        served += given
    assert served == pace.level.limiter.updates == 30  # half of the rows: neither starved nor overdriven


def test_a_learner_that_was_replaced_gets_nothing_and_changes_no_priority(pace):
    pace.ask(20, 0)
    pace.ask(21, 2)
    before = pace.level.limiter.updates
    assert pace.ask(20, 4) == 0
    assert pace.level.limiter.updates == before
    assert pace.replay.level_replays[Level.LOW].learner_epoch == 21


def test_a_replay_that_was_replaced_too_still_knows_the_learner(pace):
    pace.ask(20, 0)
    pace.ask(21, 2)
    pace.replay.transport.close()
    pace.begin()
    assert pace.level.learner_epoch == 21
    before = pace.level.limiter.updates
    pace.ask(21, 3)
    assert pace.level.limiter.updates == before + 4  # nothing is given twice
    assert pace.ask(22, 0, batches=1) == 1
    assert pace.level.limiter.updates == 1


def test_the_first_learner_of_a_start_counts_from_what_it_knows(pace):
    pace.level.limiter.resume_at(10)
    pace.ask(20, 3)  # an earlier start lost some, or a version before this one did not count them
    assert pace.level.limiter.updates == 14
    pace.ask(21, 4)
    assert pace.level.limiter.updates == 11 + 4
