import dataclasses
import json
import threading
from concurrent.futures import Future

import numpy as np
import pytest

from zsdist.common.background import at_once
from zsdist.config import LevelConfig, load, parse
from zsdist.dqn.learner import DqnLearner
from zsdist.errors import RunError
from zsdist.roles import divergence
from zsdist.roles.base import Context
from zsdist.roles.learner import BATCHES_AN_ANSWER, PREFETCH, UPDATES_A_STEP, Learner
from zsdist.roles.rollback import ALLOWED
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level, StoredBatch
from zsdist.wire import codec, keys
from zsdist.wire.messages import Candidate, Orders, Priorities, SampleReply, SampleRequest, WeightsMessage

FEATURES, ACTIONS, RUN = 3, 2, "test"


def batch(rng, rows=4):
    return StoredBatch(
        states=rng.normal(size=(rows, FEATURES)).astype(np.float16),
        actions=rng.integers(0, ACTIONS, rows).astype(np.uint8),
        rewards=np.zeros(rows, np.float32),
        discounts=np.zeros(rows, np.float32),
        next_states=rng.normal(size=(rows, FEATURES)).astype(np.float16),
        next_masks=np.ones((rows, ACTIONS), bool),
        masks=np.ones((rows, ACTIONS), bool),
        guides=np.full(rows, -1, np.int8),
    )


class Bench:
    """Learner at a memory transport; the test plays the replay and the scheduler."""

    def __init__(self, shards=1, low=None, refused=None, background=at_once):
        self.rng, self.broker, self.now = np.random.default_rng(0), MemoryBroker(), 0.0
        self.others = MemoryTransport(self.broker)
        self.shards, self.weights = [Mailbox(2**20) for _ in range(shards)], Mailbox(2**24)
        self.requests = self.shards[0]
        for index, box in enumerate(self.shards):
            self.others.serve(keys.sample(RUN, Level.LOW, index), box)
        self.others.subscribe(keys.weights(RUN, Level.LOW), self.weights)
        config = parse({"replay": {"shards": shards, "prioritised": True}, "low": low or {}, "run": {"actors": 2}})
        wake = threading.Event()
        context = Context(config, RUN, "learner", "low", 1, MemoryTransport(self.broker), wake, background)
        dqn = DqnLearner(FEATURES, ACTIONS, LevelConfig(hidden=(8,)) if low is None else config.low, seed=0)
        self.learner = Learner(context, Level.LOW, dqn, refused=refused)

    def step(self, seconds=0.1):
        self.now += seconds
        return self.learner.step(self.now)

    def answer(self, requests, waited_s=0.0, held=100):
        for request in requests:
            batches = codec.decode(request.payload, expect=SampleRequest).batches
            found = batch(self.rng, rows=4 * batches) if held else None
            request.reply(codec.encode(SampleReply(Level.LOW, found, held, waited_s, batches)))

    def order(self, learning):
        content = {"learning": learning, "merge": 0, "candidates": [], "chosen": "", "stop": False}
        self.others.publish(keys.control(RUN, "learner"), codec.encode(Orders(1, "learner", content)))


@pytest.fixture
def bench():
    return Bench()


def test_more_batches_are_requested_before_each_update(bench, monkeypatch):
    bench.step()
    assert len(bench.requests) * BATCHES_AN_ANSWER == PREFETCH
    bench.answer(bench.requests.drain())
    asked = []
    monkeypatch.setattr(bench.learner.dqn, "update", lambda batch: asked.append(len(bench.requests)))
    bench.step()
    assert asked == [update // BATCHES_AN_ANSWER for update in range(1, UPDATES_A_STEP + 1)]


def test_each_batch_of_an_answer_is_an_update_and_missing_ones_are_requested_again(bench, monkeypatch):
    bench.step()
    learned = []
    monkeypatch.setattr(bench.learner.dqn, "update", lambda batch: learned.append(batch.states.tolist()))
    drawn = batch(bench.rng, rows=12)
    first, *others = bench.requests.drain()
    first.reply(codec.encode(SampleReply(Level.LOW, drawn, 100, 0.0, 3)))
    for request in others:
        request.reply(codec.encode(SampleReply(Level.LOW, None, 100, 0.0)))
    bench.step()
    kept = drawn.states.astype(np.float16).astype(np.float32)
    assert learned == [kept[start : start + 4].tolist() for start in (0, 4, 8)]
    assert len(bench.requests) * BATCHES_AN_ANSWER == PREFETCH


def test_updates_are_followed_by_another_step_at_once(bench):
    bench.step()
    bench.answer(bench.requests.drain()[:1])
    assert bench.step() == bench.now
    assert bench.learner.updates == BATCHES_AN_ANSWER
    assert bench.step() > bench.now


def test_time_without_a_batch_is_counted_and_split_by_whether_the_replay_had_one(bench):
    bench.step()
    bench.step(1.0)
    bench.answer(bench.requests.drain(), waited_s=0.75)
    bench.step(0.0)
    fields = bench.learner.statistics()
    assert fields["waiting_data_s"] == pytest.approx(1.0)
    assert fields["waiting_reply_s"] == pytest.approx(0.25)


def test_an_empty_replay_does_not_count_as_one_that_answers_late(bench):
    bench.step()
    for seconds, held in ((2.0, 0), (2.0, 0), (2.0, 0), (1.0, 100)):
        bench.now += seconds
        bench.answer(bench.requests.drain(), waited_s=seconds, held=held)
        bench.step(0.0)
    fields = bench.learner.statistics()
    assert fields["waiting_data_s"] == pytest.approx(7.0)
    assert fields["waiting_reply_s"] == pytest.approx(0.0)


def test_a_paused_learner_counts_no_waiting_time(bench):
    bench.order(learning=False)
    bench.step()
    bench.step(5.0)
    assert bench.learner.statistics()["waiting_data_s"] == 0.0
    assert not bench.requests


def test_repeated_weights_keep_the_time_at_which_their_version_was_made(bench):
    bench.step()
    bench.answer(bench.requests.drain()[:1])
    bench.step()
    for _ in range(60):
        bench.step()
    published = [codec.decode(message.payload, expect=WeightsMessage) for message in bench.weights.drain()]
    last = [message for message in published if message.weights.version == published[-1].weights.version]
    assert len(last) > 1
    assert len({message.made_s for message in last}) == 1
    assert 0 < last[0].made_s <= bench.now - 2.0


def test_batches_come_from_each_shard_in_proportion_to_what_it_holds():
    bench, given = Bench(shards=2), [0, 0]
    learned = []
    bench.learner.dqn.update = lambda batch: learned.append(batch.rewards[0])
    bench.step()
    for _ in range(50):
        for index, (box, held) in enumerate(zip(bench.shards, (300, 100), strict=True)):
            for request in box.drain():
                given[index] += BATCHES_AN_ANSWER
                rows = 4 * BATCHES_AN_ANSWER
                marked = dataclasses.replace(batch(bench.rng, rows), rewards=np.full(rows, index, np.float32))
                request.reply(codec.encode(SampleReply(Level.LOW, marked, held, 0.0, BATCHES_AN_ANSWER)))
        bench.step()
    assert bench.learner.updates == 50 * UPDATES_A_STEP
    assert learned.count(0) / learned.count(1) == pytest.approx(3.0, rel=0.05)
    assert given[0] - learned.count(0) <= PREFETCH and given[1] - learned.count(1) <= PREFETCH


@pytest.mark.parametrize("learned", [False, True])
def test_an_event_reports_a_distilled_candidate_that_equals_the_recent_one(learned):
    bench, events = Bench(), Mailbox(2**20)
    bench.others.subscribe(keys.events(RUN), events)
    bench.step()
    if learned:
        bench.answer(bench.requests.drain())
        bench.step()
    content = {"learning": False, "merge": 1, "candidates": ["recent", "distilled"]}
    orders = Orders(1, "learner", content | {"chosen": "", "stop": False})
    bench.others.publish(keys.control(RUN, "learner"), codec.encode(orders))
    bench.step()
    names = [json.loads(message.payload)["event"] for message in events.drain()]
    assert names == ([] if learned else ["distilled_is_recent"])


def test_a_missing_shard_does_not_stop_learning_from_the_others():
    bench = Bench(shards=2)
    bench.step()
    for _ in range(5):
        bench.answer(bench.shards[1].drain())
        bench.step()
    assert bench.learner.updates == 5 * UPDATES_A_STEP
    assert len(bench.shards[0]) * BATCHES_AN_ANSWER == PREFETCH


def test_errors_of_rows_sampled_by_priority_go_to_the_shard_they_came_from():
    bench, published = Bench(shards=2), [Mailbox(2**20), Mailbox(2**20)]
    for index, box in enumerate(published):
        bench.others.subscribe(keys.priority(RUN, Level.LOW, index), box)
    bench.step()
    drawn = dataclasses.replace(batch(bench.rng), weights=np.ones(4, np.float32), serials=np.array([7, 9, 7, 3]))
    bench.shards[1].drain()[0].reply(codec.encode(SampleReply(Level.LOW, drawn, 100, 0.0)))
    bench.answer(bench.shards[0].drain()[:1])  # a batch without priorities has no errors to publish
    bench.step()
    assert bench.learner.updates == 1 + BATCHES_AN_ANSWER
    assert not published[0]
    (found,) = (codec.decode(message.payload, expect=Priorities) for message in published[1].drain())
    assert found.serials.tolist() == [7, 9, 7, 3]
    assert (found.errors > 0).all()


def merge_orders(merge, chosen=""):
    candidates = ["recent", "distilled", "best"] if merge > 1 else ["recent", "distilled"]
    return {
        "learning": False,
        "merge": merge,
        "candidates": candidates,
        "chosen": chosen,
        "stop": False,
    }


def test_merges_leave_no_more_retained_values_or_tokens_than_the_second_one(bench):
    transport = bench.learner.transport
    kept = []
    for merge in range(1, 30):
        for chosen in ("", "recent"):
            content = merge_orders(merge, chosen)
            bench.others.publish(keys.control(RUN, "learner"), codec.encode(Orders(1, "learner", content)))
            bench.step()
        kept.append((len(transport.kept), len(transport.tokens)))
    assert bench.learner.merge == 29
    assert set(kept[1:]) == {(1 + 3, 1)}  # weights and one candidate of each name


def test_a_late_actor_gets_the_newest_candidate_of_each_name_alone(bench):
    for merge in range(1, 5):
        for chosen in ("", "distilled"):
            content = merge_orders(merge, chosen)
            bench.others.publish(keys.control(RUN, "learner"), codec.encode(Orders(1, "learner", content)))
            bench.step()
    late = Mailbox(2**24)
    bench.others.subscribe(keys.candidate(RUN, keys.ANY, keys.ANY), late, retained=True)
    found = [codec.decode(message.payload, expect=Candidate) for message in late.drain()]
    assert sorted((message.name, message.merge) for message in found) == [("best", 4), ("distilled", 4), ("recent", 4)]


def reward_batch(rng, reward, rows=4):
    return dataclasses.replace(batch(rng, rows), rewards=np.full(rows, reward, np.float32))


def diverge(bench, reward, steps=400):
    """Feed batches with a reward until the learner raises; return its message and the last state before."""
    saved = bench.learner.state()
    for _ in range(steps):
        for request in bench.requests.drain():
            batches = codec.decode(request.payload, expect=SampleRequest).batches
            drawn = reward_batch(bench.rng, reward, 4 * batches)
            request.reply(codec.encode(SampleReply(Level.LOW, drawn, 100, 0.0, batches)))
        try:
            bench.step()
        except RunError as error:
            return str(error), saved
        saved = bench.learner.state()
    raise AssertionError("it did not diverge")


@pytest.mark.parametrize("reward", [1e38, 3e5])
def test_a_level_whose_values_leave_their_range_ends_the_run_with_the_cause(reward):
    bench = Bench(
        low={"reward_scale": 1e4, "hidden": [8], "huber": False, "max_gradient_norm": 1e30, "learning_rate": 0.5}
    )
    content = merge_orders(0) | {"learning": True, "candidates": [], "finished": 12}
    bench.others.publish(keys.control(RUN, "learner"), codec.encode(Orders(1, "learner", content)))
    bench.step()
    events = Mailbox(2**20)
    bench.others.subscribe(keys.events(RUN), events)
    message, saved = diverge(bench, reward)
    assert "the low level diverged at update" in message and "after 12 episodes" in message
    assert "low.learning_rate is 0.5" in message and "--set low.learning_rate=0.002" in message
    assert all(np.isfinite(array).all() for array in saved.arrays.values())
    told = [json.loads(message.payload) for message in events.drain()]
    assert [event["event"] for event in told] == ["rolled_back"] * ALLOWED + ["diverged"]
    assert all((event["level"], event["finished"]) == ("low", 12) for event in told)


def test_a_network_that_is_not_finite_is_in_no_state_and_no_message(bench, monkeypatch):
    wrong = {name: np.full_like(array, np.nan) for name, array in bench.learner.dqn.parameters().items()}
    monkeypatch.setattr(bench.learner.dqn, "parameters", lambda: wrong)
    with pytest.raises(RunError, match=r"the low level diverged.* not finite"):
        bench.learner.state()
    with pytest.raises(RunError, match=r"the low level diverged.* not finite"):
        bench.step()
    assert not bench.weights.drain()


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({}, "low.learning_rate=0.0002"),
        ({"low": {"learning_rate": 0.1}}, "low.learning_rate=0.002"),
        ({"low": {"reward_scale": 100.0}}, "low.reward_scale=1.0"),
        ({"low": {"guide_margin": 1e5}}, "low.guide_margin=0.8"),
        ({"low": {"huber": False}}, "low.huber=true"),
        ({"low": {"discount": 1.0}}, "low.discount=0.95"),
        ({"reward": {"literal": True, "goal": 1e6}}, "reward.goal=1000.0"),
    ],
)
def test_the_remedy_names_the_most_unusual_setting_and_can_be_pasted(settings, named):
    message = str(divergence.diverged(parse(settings), Level.LOW, 1, 2, "found"))
    override = message.partition("--set ")[2].partition(";")[0]
    assert override == named
    load(None, (override,))


def test_no_return_of_ordinary_rewards_is_beyond_the_limit():
    for settings in ({}, {"reward": {"literal": True}}, {"low": {"discount": 1.0}}):
        config = parse(settings)
        largest = 1300 if config.reward.literal else divergence.SHAPED_REWARD
        horizon = min(config.sim.max_steps, 1 / max(1 - config.low.discount, 1e-9))
        assert divergence.value_limit(config, Level.LOW) > 100 * largest * horizon


def test_a_captured_state_does_not_change_with_later_updates(bench):
    bench.step()
    make, before = bench.learner.capture(bench.now), bench.learner.state()
    bench.answer(bench.requests.drain())
    bench.step()
    assert bench.learner.updates > before.meta["updates"]
    found = make()
    assert found.meta == before.meta
    assert all(np.array_equal(array, found.arrays[name]) for name, array in before.arrays.items())


def test_weights_are_encoded_beside_the_steps_as_they_were_when_they_were_published():
    waiting = []
    bench = Bench(background=lambda function: waiting.append(function) or Future())
    bench.step()
    version, before = bench.learner.version, bench.learner.dqn.parameters()
    assert waiting and not bench.weights.drain()
    for _ in range(3):
        bench.answer(bench.requests.drain())
        bench.step()
    assert bench.learner.updates and not bench.weights.drain()
    waiting[0]()
    (found,) = (codec.decode(message.payload, expect=WeightsMessage).weights for message in bench.weights.drain())
    assert found.version == version
    assert all(np.array_equal(array, found.parameters[name]) for name, array in before.items())
