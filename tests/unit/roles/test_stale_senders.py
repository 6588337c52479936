"""A process that was replaced and wakes up: on every arrow its messages are refused, and change nothing."""

import dataclasses

import numpy as np
import pytest
from mailboxes import PARAMETERS, REPLAY, RUN, Bench
from wire_messages import push

from zsdist.dqn import network
from zsdist.types import Ack, Level, Weights
from zsdist.wire import codec, keys
from zsdist.wire.messages import (
    Candidate,
    Jobs,
    Orders,
    Priorities,
    Records,
    SampleRequest,
    WeightsMessage,
)

OLD, NEW = 4, 5  # epochs of a sender
OTHER = {name: array + 1 for name, array in PARAMETERS.items()}
LEARNER = {"learning": True, "merge": 0, "candidates": [], "chosen": "", "stop": False}
ACTOR = {"finished": 0, "merge": 1, "closing": False, "cut": False}
JOBS = {"epoch": 9, "leases": [], "finished": 0, "merge": 1, "drives": []}


@pytest.fixture
def bench(tmp_path):
    return lambda role, **settings: Bench(role, tmp_path / "journal", **settings)


def weights(epoch, version, parameters, merge=0):
    sha256 = network.sha256(parameters)
    return WeightsMessage(epoch, merge, sha256, 1.0, Weights(Level.LOW, version, parameters))


def test_an_actor_takes_no_weights_of_an_older_learner_whatever_their_version(bench):
    actor = bench("actor-0")
    for message in (weights(OLD, 90, OTHER), weights(NEW, 10, PARAMETERS), weights(OLD, 99, OTHER)):
        actor.send(keys.weights(RUN, "low"), message)
    assert actor.refused() == {"stale": 1}
    assert actor.role.statistics()["low_weight_version"] == 10


def test_an_actor_takes_no_candidate_of_an_older_learner(bench):
    actor = bench("actor-0")
    actor.send(keys.weights(RUN, "low"), weights(NEW, 10, PARAMETERS))
    actor.send(keys.candidate(RUN, "low", "recent"), Candidate(OLD, Level.LOW, 1, "recent", PARAMETERS))
    actor.send(keys.candidate(RUN, "low", "recent"), Candidate(NEW, Level.LOW, 1, "recent", PARAMETERS))
    assert actor.refused() == {"stale": 1}


def test_an_actor_follows_no_orders_and_jobs_of_an_older_scheduler(bench):
    actor = bench("actor-0")
    actor.send(keys.control(RUN, "actor"), Orders(NEW, "actor", ACTOR))
    actor.send(keys.control(RUN, "actor"), Orders(OLD, "actor", ACTOR | {"closing": True, "cut": True}))
    actor.send(keys.evaluation(RUN, "actor-0"), Jobs(OLD, "actor-0", JOBS))
    assert actor.refused() == {"stale": 2}


@pytest.mark.parametrize("stream", ["low", "high", "episodes", "evaluation"])
def test_an_actor_believes_no_acknowledgement_of_an_older_receiver(bench, stream):
    actor = bench("actor-0")
    actor.send(keys.ack(RUN, "actor-0"), Ack(NEW, "actor-0", 9, stream, 0, None))
    actor.send(keys.ack(RUN, "actor-0"), Ack(OLD, "actor-0", 9, stream, 0, 10**6))
    actor.refused()
    assert actor.role.statistics()[f"{stream}_ignored_acks"] == 1


def test_a_scheduler_counts_nothing_of_an_older_learner(bench):
    scheduler = bench("scheduler-0")
    scheduler.send(keys.weights(RUN, "low"), weights(NEW, 10, PARAMETERS))
    scheduler.send(keys.weights(RUN, "low"), weights(OLD, 99, OTHER, merge=7))
    assert scheduler.refused() == {"stale": 1}


def test_a_scheduler_obeys_no_older_supervisor_and_counts_no_episode_of_an_older_actor(bench):
    scheduler = bench("scheduler-0")
    content = {"epochs": {"actor-0": 8}, "restarts": {}, "interrupted": False}
    scheduler.send(keys.control(RUN, "scheduler"), Orders(NEW, "scheduler", content))
    scheduler.send(keys.control(RUN, "scheduler"), Orders(OLD, "scheduler", content | {"interrupted": True}))
    scheduler.send(keys.episodes(RUN, "actor-0", 7), Records("episodes", "actor-0", 7, 0, 0, True, ()))
    assert scheduler.refused() == {"stale": 1}
    assert scheduler.role.stage == "train"


def test_a_replay_serves_no_older_learner_and_takes_none_of_its_priorities(bench):
    replay = bench("replay-0", replay={"prioritised": True})
    for epoch in (NEW, OLD):
        request = codec.encode(SampleRequest(epoch, Level.LOW, 0))
        replay.others.request(keys.sample(RUN, "low"), request, replay.answers, timeout_s=1.0)
    assert replay.refused() == {"stale": 1}
    for epoch in (NEW, OLD):
        priorities = Priorities(epoch, Level.LOW, np.arange(4), np.ones(4, np.float32))
        replay.send(keys.priority(RUN, "low"), priorities)
    assert replay.refused() == {"stale": 2}


def test_a_replay_obeys_no_older_scheduler_and_stores_no_frame_of_an_older_actor(bench):
    replay = bench("replay-0")
    replay.send(keys.control(RUN, "replay"), Orders(NEW, "replay", REPLAY | {"epochs": {"actor-0": 8}}))
    replay.send(keys.control(RUN, "replay"), Orders(OLD, "replay", REPLAY | {"stop": True}))
    assert replay.refused() == {"stale": 1}
    frame = push(np.random.default_rng(0), actor="actor-0", epoch=7, sequence=0, produced=21)
    replay.send(keys.push(RUN, "low", "actor-0", 7), dataclasses.replace(frame, epoch=7))
    replay.refused()
    fields = replay.role.statistics()
    assert fields["low_refused_closed_epoch"] == 1 and fields["low_produced"] == 0


@pytest.mark.parametrize("role", ["replay-0", "learner-low"])
def test_no_role_gives_its_state_to_an_older_scheduler_or_in_the_name_of_its_successor(bench, role):
    asked = bench(role)
    kind, _, _ = role.partition("-")
    content = REPLAY if kind == "replay" else LEARNER
    asked.send(keys.control(RUN, kind), Orders(NEW, kind, content))
    asked.refused()
    key = keys.control(RUN, "replay" if kind == "replay" else role)
    for epoch, wanted in ((OLD, 0), (NEW, 10), (NEW, 9), (NEW, 0)):  # its own epoch is 9
        order = Orders(epoch, key.rpartition("/")[2], {"ask": "state", "epoch": wanted})
        asked.others.request(key, codec.encode(order), asked.answers, timeout_s=1.0)
    assert asked.refused() == {"stale": 2}
    assert len(asked.answers) == 2


def test_a_learner_obeys_no_older_scheduler(bench):
    learner = bench("learner-low")
    learner.send(keys.control(RUN, "learner"), Orders(NEW, "learner", LEARNER))
    learner.send(keys.control(RUN, "learner"), Orders(OLD, "learner", LEARNER | {"stop": True}))
    assert learner.refused() == {"stale": 1}
