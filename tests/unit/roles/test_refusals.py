"""Refused messages: a role counts them by reason in its statistics, and nothing else changes."""

import dataclasses

import numpy as np
import pytest
from mailboxes import LOW, PARAMETERS, REPLAY, RUN, Bench
from wire_messages import batch, push

from zsdist.dqn import network
from zsdist.transport.base import Mailbox
from zsdist.types import Ack, Level, Weights
from zsdist.wire import codec, keys
from zsdist.wire.messages import Candidate, Jobs, Orders, Records, SampleReply, SampleRequest, WeightsMessage


@pytest.fixture
def bench(tmp_path):
    return lambda role: Bench(role, tmp_path / "journal")


def test_a_replay_refuses_pushes_under_another_actors_key_or_of_another_run(bench):
    replay = bench("replay-0")
    replay.send(keys.control(RUN, "replay"), Orders(1, "replay", REPLAY | {"epochs": {"actor-0": 7, "actor-1": 8}}))
    replay.refused()
    true = push(np.random.default_rng(0), actor="actor-0", epoch=7, sequence=0, produced=21)
    for level, actor, epoch in (("low", "actor-1", 8), ("low", "actor-0", 6), ("high", "actor-0", 7)):
        replay.send(keys.push(RUN, level, actor, epoch), true)
    replay.send(keys.push("other", "low", "actor-0", 7), true)  # not subscribed to
    assert replay.refused() == {"key": 3}
    for _ in range(2):
        replay.send(keys.push(RUN, "low", "actor-0", 7), true)
    replay.refused()
    fields = replay.role.statistics()
    assert (fields["low_produced"], fields["low_duplicates"], fields["low_rejected"]) == (
        21,
        1,
        21,
    )  # with states of another size


def test_a_replay_refuses_orders_that_are_invalid_too_large_or_stale(bench):
    replay = bench("replay-0")
    key = keys.control(RUN, "replay")
    for content in ({}, REPLAY | {"epochs": [1]}, REPLAY | {"stop": 1}, REPLAY | {"buffer_size": -1}):
        replay.send(key, Orders(5, "replay", content))
    replay.send(key, Orders(5, "replay", REPLAY | {"buffer_size": 10**9}))
    replay.send(key, Orders(5, "replay", REPLAY))
    replay.send(key, Orders(4, "replay", REPLAY | {"stop": True}))
    replay.send(key, Orders(5, "actor", REPLAY))
    replay.send(key, Ack(1, "actor-0", 7, "low", 0, None))
    assert replay.refused() == {"content": 4, "size": 1, "stale": 1, "key": 1, "unexpected": 1}
    assert replay.role.level_replays[Level.LOW].buffer.capacity == 2000


def test_a_replay_answers_valid_requests_only_and_queues_a_limited_number(bench):
    replay = bench("replay-0")
    for payload in (b"", b"rubbish" * 9, codec.encode(Orders(1, "replay", {"ask": "money"}))):
        replay.others.request(keys.control(RUN, "replay"), payload, replay.answers, timeout_s=1.0)
    assert replay.refused() == {"short": 1, "magic": 1, "content": 1}
    assert not replay.answers
    replay.others.request(
        keys.control(RUN, "replay"), codec.encode(Orders(1, "replay", {"ask": "state"})), replay.answers, timeout_s=1.0
    )
    for _ in range(300):
        request = codec.encode(SampleRequest(1, Level.LOW, 0))
        replay.others.request(keys.sample(RUN, "low"), request, replay.answers, timeout_s=1.0)
    assert replay.refused()["requests"] == 300 - 256
    assert len(replay.answers) == 1


def test_an_actor_refuses_weights_of_another_network_or_with_a_wrong_hash(bench):
    actor = bench("actor-0")
    other = PARAMETERS | {"output.bias": np.zeros(LOW.actions + 1, np.float32)}
    for sha256, parameters in ((network.sha256(other), other), ("0" * 64, PARAMETERS)):
        actor.send(keys.weights(RUN, "low"), WeightsMessage(1, 0, sha256, 1.0, Weights(Level.LOW, 5, parameters)))
    actor.send(keys.candidate(RUN, "low", "recent"), Candidate(1, Level.LOW, 1, "recent", other))
    for merge in range(30):
        actor.send(keys.candidate(RUN, "low", "x"), Candidate(1, Level.LOW, merge, "x", PARAMETERS))
    assert actor.refused() == {"weights": 2, "hash": 1, "candidates": 14}
    assert "low_weight_version" not in actor.role.statistics()
    message = WeightsMessage(1, 0, network.sha256(PARAMETERS), 1.0, Weights(Level.LOW, 5, PARAMETERS))
    actor.send(keys.weights(RUN, "low"), message)
    actor.refused()
    assert actor.role.statistics()["low_weight_version"] == 5


def test_an_actor_refuses_invalid_orders_jobs_and_acks(bench):
    actor = bench("actor-0")
    actor.send(keys.control(RUN, "actor"), Orders(1, "actor", {"closing": True}))
    actor.send(keys.evaluation(RUN, "actor-0"), Jobs(1, "actor-0", {"merge": 1, "drives": [["recent", "x"]]}))
    actor.send(keys.evaluation(RUN, "actor-0"), Records("evaluation", "actor-0", 9, 0, 1, False, ({},)))  # its own
    actor.send(keys.ack(RUN, "actor-0"), Ack(1, "actor-1", 9, "low", 10**6, None))
    actor.send(keys.ack(RUN, "actor-0"), Ack(1, "actor-0", 9, "low", 10**6, None))  # beyond what was sent
    assert actor.refused() == {"content": 2, "key": 1}
    assert actor.role.statistics()["low_ignored_acks"] == 1


def test_a_learner_refuses_batches_of_another_shape(bench):
    learner = bench("learner-low")
    asked = Mailbox(2**20)
    learner.others.serve(keys.sample(RUN, "low"), asked)
    learner.refused()
    for payload in (b"rubbish" * 9, codec.encode(Ack(1, "a", 0, "low", 0, None)), codec.encode(of_shape(3, 2))):
        asked.drain()[0].reply(payload)
        learner.refused()
        learner.now += 10.0  # a request without a valid answer is sent again
        learner.refused()
    assert learner.refused() == {"magic": 1, "unexpected": 1, "shape": 1}
    assert learner.role.updates == 0
    asked.drain()[0].reply(codec.encode(of_shape(LOW.state_size, LOW.actions)))
    learner.refused()
    assert learner.role.updates == 1


def of_shape(features, actions):
    rng = np.random.default_rng(0)
    sizes = {"states": features, "next_states": features, "masks": actions, "next_masks": actions}
    sound = batch(rng)
    changed = {name: np.zeros((16, size), getattr(sound, name).dtype) for name, size in sizes.items()}
    changed |= {name: np.zeros(16, np.int64) for name in ("actions", "guides")}
    return SampleReply(Level.LOW, dataclasses.replace(sound, **changed), 100, 0.0)


def test_a_scheduler_neither_counts_nor_acknowledges_invalid_episodes(bench):
    scheduler = bench("scheduler-0")
    acks = Mailbox(2**20)
    scheduler.others.subscribe(keys.ack(RUN, keys.ANY), acks)
    key = keys.control(RUN, "scheduler")
    scheduler.send(key, Orders(1, "scheduler", {"epochs": {"actor-0": 7}, "restarts": {}, "interrupted": False}))
    scheduler.send(key, Orders(1, "scheduler", {"epochs": {}, "restarts": {}, "interrupted": "yes"}))
    scheduler.refused()
    for record in ({}, {"episode": 1}):
        scheduler.send(keys.episodes(RUN, "actor-0", 7), Records("episodes", "actor-0", 7, 0, 1, False, (record,)))
    scheduler.send(keys.episodes(RUN, "actor-1", 7), Records("episodes", "actor-0", 7, 0, 1, False, ({},)))
    scheduler.send(keys.weights(RUN, "low"), Orders(1, "actor", {}))
    assert scheduler.refused() == {"content": 3, "key": 1, "unexpected": 1}
    received = [codec.decode(message.payload).received for message in acks.drain()]
    assert set(received) == {0}
    assert scheduler.role.statistics()["episodes"] == 0
