"""Decoding returns what was encoded, and both sides refuse values that are not allowed."""

import dataclasses

import numpy as np
import pytest
from wire_messages import (
    ACTIONS,
    STATE_SIZE,
    batch,
    broken,
    drawn_by_priority,
    every_message,
    parameters,
    plain,
    push,
    reason,
    trajectory,
)

from zsdist.errors import ProtocolError
from zsdist.types import Level, Weights
from zsdist.wire import frame
from zsdist.wire.codec import decode, encode
from zsdist.wire.messages import Orders, Priorities, Push, SampleReply, SampleRequest, WeightsMessage


def reseal(payload: bytes, meta: dict, columns: dict[str, np.ndarray]) -> bytes:
    """Return `payload` with other content, as sent by a stranger with this code but without its checks."""
    return frame.pack(frame.read_kind(payload), meta, columns, 2**30)


@pytest.mark.parametrize("index", range(len(every_message(np.random.default_rng(0)))))
def test_every_message_is_decoded_to_an_equal_one(index: int) -> None:
    message = every_message(np.random.default_rng(index))[index]
    assert plain(decode(encode(message))) == plain(message)


def test_decoded_arrays_may_be_written_to() -> None:
    decoded = decode(encode(push(np.random.default_rng(0))))
    for name in ("states", "actions", "rewards", "masks"):
        getattr(decoded.trajectories[1], name)[:] = 0
    assert decoded.trajectories[0].states.any()


def test_states_lose_no_more_than_half_precision_and_only_once() -> None:
    rng = np.random.default_rng(0)
    sent = broken(rng, states=(rng.normal(size=(5, STATE_SIZE)) * 1000).astype(np.float32))
    once = decode(encode(sent))
    twice = decode(encode(once))
    original, received = sent.trajectories[0].states, once.trajectories[0].states
    assert received.dtype == np.float32
    assert np.abs(received - original).max() > 0
    np.testing.assert_allclose(received, original, rtol=2**-11)
    assert plain(twice) == plain(once)


@pytest.mark.parametrize(
    ("column", "place", "value", "expected"),
    [
        ("states", (2, 3), np.nan, "nonfinite"),
        ("states", (0, 0), np.inf, "nonfinite"),
        ("rewards", 1, np.nan, "nonfinite"),
        ("discounts", 0, 1.5, "discount"),
        ("discounts", 0, -0.1, "discount"),
        ("actions", 3, ACTIONS, "action"),
        ("guides", 3, ACTIONS, "guide"),
        ("guides", 3, -2, "guide"),
        ("behaviours", 0, 3, "behaviour"),
        ("successors", 0, 0, "successor"),
        ("successors", 3, 9, "successor"),
        ("successors", 0, 4, "successor"),
    ],
)
def test_a_wrong_value_is_refused_on_both_sides(column: str, place: object, value: float, expected: str) -> None:
    rng = np.random.default_rng(0)
    sound = broken(rng)
    changed = getattr(sound.trajectories[0], column).copy()
    changed[place] = value
    with pytest.raises(ProtocolError, match=f"Push cannot be sent: {expected}"):
        encode(broken(rng, **{column: changed}))
    payload = encode(sound)
    meta, columns = frame.unpack(payload, 2**20)
    columns[column][place] = value
    assert reason(reseal(payload, meta, columns)) == expected


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"stream": "middle"}, "stream"),
        ({"stream": ["low"]}, "stream"),
        ({"actor": "a/b"}, "name"),
        ({"actor": ""}, "name"),
        ({"epoch": -1}, "count"),
        ({"epoch": True}, "count"),
        ({"epoch": 1.0}, "count"),
        ({"sequence": 2**62}, "count"),
        ({"produced": 20}, "total"),
        ({"closes": 1}, "field"),
        ({"actions": 8}, "action"),
        ({"actions": 0}, "actions"),
        ({"actions": 65}, "actions"),
        ({"actions": 16}, "mask"),
        ({"extra": 1}, "field"),
    ],
)
def test_wrong_fields_are_refused_by_reason(changes: dict, expected: str) -> None:
    payload = encode(push(np.random.default_rng(1)))
    meta, columns = frame.unpack(payload, 2**20)
    if changes == {"actions": 16}:
        columns["masks"] = columns["masks"][:, :1]
    assert reason(reseal(payload, meta | changes, columns)) == expected


def test_wrong_columns_are_refused_by_reason() -> None:
    payload = encode(push(np.random.default_rng(1)))
    meta, columns = frame.unpack(payload, 2**20)

    def changed(**replaced: np.ndarray) -> str:
        return reason(reseal(payload, meta, columns | replaced))

    assert changed(extra=columns["actions"]) == "column"
    assert reason(reseal(payload, meta, {name: columns[name] for name in list(columns)[1:]})) == "column"
    assert changed(states=columns["states"].astype(np.float32)) == "dtype"
    assert changed(actions=columns["actions"][:, None]) == "shape"
    assert changed(actions=columns["actions"][1:]) == "shape"
    assert changed(states=columns["states"][1:]) == "shape"
    assert changed(states=columns["states"][:, :0]) == "shape"
    assert changed(lengths=columns["lengths"] * 0) == "lengths"
    assert changed(masks=columns["masks"] | 1) == "mask"
    assert reason(reseal(payload, meta, {})) == "actions"
    assert reason(reseal(payload, meta | {"actions": 0}, {})) == "empty"


def test_an_empty_frame_must_close() -> None:
    with pytest.raises(ProtocolError, match="empty"):
        encode(Push(Level.LOW, "a", 0, 0, 0, False, ()))


@pytest.mark.parametrize(
    ("message", "column", "value", "expected"),
    [
        ("reply", "weights", 0.0, "weight"),
        ("reply", "weights", 1.5, "weight"),
        ("reply", "weights", np.nan, "weight"),
        ("reply", "serials", -1, "range"),
        ("priorities", "serials", -1, "range"),
        ("priorities", "errors", -0.5, "range"),
        ("priorities", "errors", np.inf, "nonfinite"),
    ],
)
def test_wrong_priorities_are_refused(message: str, column: str, value: float, expected: str) -> None:
    rng = np.random.default_rng(0)
    sound = {
        "reply": SampleReply(Level.LOW, drawn_by_priority(rng), 100, 0.0),
        "priorities": Priorities(1, Level.LOW, np.arange(5), np.ones(5, np.float32)),
    }[message]
    payload = encode(sound)
    meta, columns = frame.unpack(payload, 2**20)
    columns[column][2] = value
    assert reason(reseal(payload, meta, columns)) == expected


@pytest.mark.parametrize("batches", [0, 17, 3, -1, True, 2.0])
def test_a_reply_of_batches_that_are_not_equal_parts_of_it_is_refused(batches: object) -> None:
    payload = encode(SampleReply(Level.LOW, batch(np.random.default_rng(0), rows=16), 100, 0.0, 2))
    meta, columns = frame.unpack(payload, 2**20)
    expected = "batches" if type(batches) is int and batches >= 0 else "count"
    assert reason(reseal(payload, meta | {"batches": batches}, columns)) == expected
    if batches not in (3, 2.0):
        meta, columns = frame.unpack(encode(SampleRequest(1, Level.LOW, 0)), 2**20)
        assert reason(reseal(encode(SampleRequest(1, Level.LOW, 0)), meta | {"batches": batches}, {})) == expected


def test_weights_must_be_finite_float32_under_a_hash() -> None:
    rng = np.random.default_rng(0)

    def sent(sha256: str = "0" * 64, **changes: np.ndarray) -> bytes:
        return encode(WeightsMessage(1, 0, sha256, 0.0, Weights(Level.LOW, 1, parameters(rng) | changes)))

    assert decode(sent()).weights.parameters["bias"].flags.writeable
    for bad in ({"bias": np.full(8, np.nan, np.float32)}, {"bias": np.zeros(8)}, {"a b": np.zeros(8, np.float32)}):
        with pytest.raises(ProtocolError):
            sent(**bad)
    with pytest.raises(ProtocolError, match="hash"):
        sent("0" * 63)


def test_the_sender_refuses_values_that_json_would_silently_change() -> None:
    for content in ({1: "key"}, {"x": (1, 2)}, {"x": float("nan")}, {"x": np.float32(1)}, {"x": np.int64(1)}):
        with pytest.raises(ProtocolError, match="json"):
            encode(Orders(1, "actor", content))


def test_every_half_float_widens_and_rounds_as_numpy_does() -> None:
    halves = np.arange(2**16, dtype=np.uint16).view(np.float16)
    halves = np.sort(halves[np.isfinite(halves)]).astype(np.float32)
    between = np.concatenate([halves, (halves[1:] + halves[:-1]) / 2, halves[:-1] * np.float32(1.0003)])
    rows = np.clip(np.resize(between, (len(between) // 60 + 1, 5, STATE_SIZE)), -65504, 65504)
    sent = push(
        np.random.default_rng(0),
        produced=10**6,
        trajectories=tuple(
            dataclasses.replace(trajectory(np.random.default_rng(0), 4), states=states) for states in rows
        ),
    )
    for received, states in zip(decode(encode(sent)).trajectories, rows, strict=True):
        assert received.states.tobytes() == states.astype(np.float16).astype(np.float32).tobytes()


def test_only_replies_to_the_learner_travel_uncompressed() -> None:
    rng = np.random.default_rng(0)
    assert encode(SampleReply(Level.LOW, batch(rng), 16, 0.0))[6] == frame.PLAIN
    assert encode(push(rng))[6] == frame.ZSTD


def test_trajectories_of_another_level_or_shape_do_not_travel_together() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ProtocolError, match="level"):
        encode(push(rng, stream=Level.HIGH))
    with pytest.raises(ProtocolError, match="shape"):
        encode(broken(rng, states=np.zeros((4, STATE_SIZE), np.float32)))
    with pytest.raises(ProtocolError, match="range"):
        encode(broken(rng, actions=np.array([0, 0, 0, 256])))
    with pytest.raises(ProtocolError, match="nonfinite"):
        encode(broken(rng, states=np.full((5, STATE_SIZE), 1e6, np.float32)))
