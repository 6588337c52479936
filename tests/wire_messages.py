"""Examples of every message, and helpers for tests of their bytes."""

import dataclasses

import numpy as np
import pytest

from zsdist.errors import DecodeError
from zsdist.types import NO_GUIDE, Level, StoredBatch, Trajectories, Trajectory, Weights
from zsdist.wire.codec import decode
from zsdist.wire.messages import (
    EPISODES,
    Ack,
    Admission,
    AnyMessage,
    Candidate,
    Jobs,
    Orders,
    Priorities,
    Push,
    Records,
    SampleReply,
    SampleRequest,
    State,
    WeightsMessage,
)

STATE_SIZE, ACTIONS = 12, 11

# Valid contents of orders, jobs and records.
ACTOR = {"finished": 0, "merge": 1, "closing": False, "cut": False}
REPLAY = {"epochs": {"actor-0": 3}, "buffer_size": 1000, "batch_size": 16, "stop": False}
LEARNER = {"learning": True, "merge": 1, "candidates": ["recent"], "chosen": "", "stop": False}
SUPERVISION = {"epochs": {}, "restarts": {"actor": 1}, "interrupted": False}
JOBS = {"epoch": 3, "leases": [1, 2], "finished": 0, "merge": 1, "drives": [["recent", 0], ["best", 3]]}
DRIVE = {"actor": "actor-0", "scene": "s", "outcome": "success", "steps": 3, "return": -1.5, "epsilon": 0.5}
DRIVE |= {"shielded": True, "path_m": 2.0, "start": [0, 0.0], "goal": [1.0, 1.0], "path": [[0.0, 0.0]], "options": 2}
EPISODE = DRIVE | {"episode": 4}
RESULT = DRIVE | {"scene_index": 1, "merge": 1, "candidate": "recent"}


def trajectory(rng: np.random.Generator, transitions: int, level: Level = Level.LOW) -> Trajectory:
    ahead = np.arange(1, transitions + 1)
    return Trajectory(
        level=level,
        states=rng.normal(size=(transitions + 1, STATE_SIZE)).astype(np.float16).astype(np.float32),
        actions=rng.integers(0, ACTIONS, transitions).astype(np.uint8),
        rewards=rng.normal(size=transitions).astype(np.float32),
        discounts=rng.random(transitions).astype(np.float32),
        successors=(ahead if level is Level.LOW else np.full(transitions, transitions)).astype(np.uint16),
        masks=rng.random((transitions + 1, ACTIONS)) < 0.8,
        guides=rng.integers(NO_GUIDE, ACTIONS, transitions).astype(np.int8),
        behaviours=rng.integers(0, 3, transitions).astype(np.uint8),
        weight_version=int(rng.integers(0, 100)),
    )


def push(rng: np.random.Generator, level: Level = Level.LOW, **changes: object) -> Push:
    trajectories = tuple(trajectory(rng, length, level) for length in (3, 1, 17))
    return dataclasses.replace(Push(level, "a-0", 4, 2, 30, False, trajectories), **changes)


def broken(rng: np.random.Generator, **columns: np.ndarray) -> Push:
    """Return a push whose only trajectory has some columns replaced."""
    return push(rng, trajectories=(dataclasses.replace(trajectory(rng, 4), **columns),))


def batch(rng: np.random.Generator, rows: int = 16) -> StoredBatch:
    states = rng.normal(size=(2, rows, STATE_SIZE)).astype(np.float16)
    return StoredBatch(
        states=states[0],
        actions=rng.integers(0, ACTIONS, rows).astype(np.uint8),
        rewards=rng.normal(size=rows).astype(np.float32),
        discounts=rng.random(rows).astype(np.float32),
        next_states=states[1],
        next_masks=rng.random((rows, ACTIONS)) < 0.5,
        masks=rng.random((rows, ACTIONS)) < 0.5,
        guides=rng.integers(NO_GUIDE, ACTIONS, rows).astype(np.int8),
    )


def drawn_by_priority(rng: np.random.Generator, rows: int = 16) -> StoredBatch:
    weights = rng.uniform(0.1, 1.0, rows).astype(np.float32)
    return dataclasses.replace(batch(rng, rows), weights=weights, serials=rng.integers(0, 10**9, rows))


def parameters(rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {"hidden.0.weight": rng.normal(size=(8, 12)).astype(np.float32), "bias": np.zeros(8, np.float32)}


def every_message(rng: np.random.Generator) -> list[AnyMessage]:
    content = {"stop": False, "leases": [1, 2, 3], "share": 0.25, "none": None, "nested": {"a": "ä\u0000"}}
    arrays = {
        "best": np.array([-np.inf, np.nan, 1.0]),
        "rng/key": np.arange(6, dtype=np.uint64).reshape(2, 3),
        "flags": np.array([True, False]),
        "scalar": np.array(7, np.int32),
        "empty": np.zeros((0, 4), np.float16),
    }
    return [
        push(rng),
        push(rng, Level.HIGH, first=True),
        Push(Level.LOW, "a-0", 4, 3, 30, True, ()),
        Records(EPISODES, "a-0", 4, 0, 2, False, ({"number": 1, "outcome": "success"}, content)),
        Ack(3, "a-0", 4, "low", 17, None),
        Ack(3, "a-0", 4, EPISODES, 17, 5000),
        SampleRequest(2, Level.HIGH, 900, 4),
        SampleReply(Level.LOW, batch(rng, rows=20), 100, 0.25, 4),
        SampleReply(Level.LOW, None, 0, 2.0),
        SampleReply(Level.LOW, drawn_by_priority(rng), 100, 0.25),
        Priorities(2, Level.LOW, np.arange(5), rng.random(5).astype(np.float32)),
        WeightsMessage(1, 2, "ab" * 32, 1.7e9, Weights(Level.LOW, 12, parameters(rng))),
        Candidate(1, Level.HIGH, 3, "distilled", parameters(rng)),
        Orders(9, "actor", content),
        Jobs(9, "a-0", content),
        Admission("actor-0", content),
        State("replay", content | {"rng": 2**120}, arrays),
    ]


def plain(value: object) -> object:
    """Return a message in a form that `==` compares completely: arrays as dtype, shape and bytes."""
    if isinstance(value, Trajectories):
        return plain(tuple(value))
    if dataclasses.is_dataclass(value):
        return type(value), {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.dtype.name, value.shape, value.tobytes()
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [type(value), *map(plain, value)]
    return type(value), value


def reason(payload: bytes, **options: object) -> str:
    with pytest.raises(DecodeError) as caught:
        decode(payload, **options)
    return caught.value.reason
