"""What is decoded equals what was encoded, and bytes that are not ours raise `DecodeError` and nothing else."""

import dataclasses
import json
import struct
import zlib

import numpy as np
import pytest
import zstandard

from zsdist.errors import DecodeError, ProtocolError
from zsdist.types import NO_GUIDE, Batch, Level, Trajectory, Weights
from zsdist.wire import frame
from zsdist.wire.codec import decode, encode
from zsdist.wire.messages import (
    EPISODES,
    Ack,
    Candidate,
    Jobs,
    Orders,
    Push,
    Records,
    SampleReply,
    SampleRequest,
    State,
    WeightsMessage,
)

STATE_SIZE, ACTIONS = 12, 11


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
    """A push whose only trajectory has some columns replaced."""
    return push(rng, trajectories=(dataclasses.replace(trajectory(rng, 4), **columns),))


def batch(rng: np.random.Generator, rows: int = 16) -> Batch:
    states = rng.normal(size=(2, rows, STATE_SIZE)).astype(np.float16).astype(np.float32)
    return Batch(
        states=states[0],
        actions=rng.integers(0, ACTIONS, rows),
        rewards=rng.normal(size=rows).astype(np.float32),
        discounts=rng.random(rows).astype(np.float32),
        next_states=states[1],
        next_masks=rng.random((rows, ACTIONS)) < 0.5,
        masks=rng.random((rows, ACTIONS)) < 0.5,
        guides=rng.integers(NO_GUIDE, ACTIONS, rows),
    )


def parameters(rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {"hidden.0.weight": rng.normal(size=(8, 12)).astype(np.float32), "bias": np.zeros(8, np.float32)}


def every_message(rng: np.random.Generator) -> list:
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
        push(rng, Level.HIGH),
        Push(Level.LOW, "a-0", 4, 3, 30, True, ()),
        Records(EPISODES, "a-0", 4, 0, 2, False, ({"number": 1, "outcome": "success"}, content)),
        Ack(3, "a-0", 4, "low", 17, None),
        Ack(3, "a-0", 4, EPISODES, 17, 5000),
        SampleRequest(2, Level.HIGH, 900),
        SampleReply(Level.LOW, batch(rng), {"size": 100}),
        SampleReply(Level.LOW, None, {"why": "empty"}),
        WeightsMessage(1, 2, "ab" * 32, Weights(Level.LOW, 12, parameters(rng))),
        Candidate(1, Level.HIGH, 3, "distilled", parameters(rng)),
        Orders(9, "actor", content),
        Jobs(9, "a-0", content),
        State("replay", content | {"rng": 2**120}, arrays),
    ]


def plain(value: object) -> object:
    """A message as something `==` compares wholly: arrays as dtype, shape and bytes."""
    if dataclasses.is_dataclass(value):
        return type(value), {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.dtype.name, value.shape, value.tobytes()
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [type(value), *map(plain, value)]
    return type(value), value


def reseal(payload: bytes, meta: dict, columns: dict[str, np.ndarray]) -> bytes:
    """What a stranger with our code but not our checks would send instead of `payload`."""
    return frame.pack(frame.read_kind(payload), meta, columns, 2**30)


def reason(payload: bytes, **options: object) -> str:
    with pytest.raises(DecodeError) as caught:
        decode(payload, **options)
    return caught.value.reason


@pytest.mark.parametrize("index", range(len(every_message(np.random.default_rng(0)))))
def test_every_message_comes_back_as_it_went(index: int) -> None:
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


def test_ten_thousand_mutated_frames_raise_only_decode_error_or_are_equal() -> None:
    rng = np.random.default_rng(7)
    messages = every_message(rng)
    frames = [encode(message) for message in messages]
    expected = [plain(message) for message in messages]
    refused = 0
    for number in range(10_000):
        which = number % len(frames)
        payload = mutate(rng, frames[which], frames[(which + 1) % len(frames)])
        if number % 2:  # with the checksum made right, so that what lies behind it is reached
            payload = payload[:12] + struct.pack("<I", checksum(payload)) + payload[16:]
        try:
            decoded = decode(payload)
        except DecodeError as error:
            assert error.reason.isidentifier()
            refused += 1
        else:
            assert number % 2 or plain(decoded) == expected[which]
    assert refused > 8_000


def test_mutated_contents_under_a_right_envelope_raise_only_decode_error_or_are_sound() -> None:
    rng = np.random.default_rng(8)
    frames = [encode(message) for message in every_message(rng)]
    inflate, deflate = zstandard.ZstdDecompressor(), zstandard.ZstdCompressor(level=1)
    refused = 0
    for number in range(6_000):
        payload = frames[number % len(frames)]
        content = inflate.decompress(payload[16:])
        other = inflate.decompress(frames[(number + 1) % len(frames)][16:])
        changed = frame.seal(frame.read_kind(payload), deflate.compress(mutate(rng, content, other)))
        try:
            encode(decode(changed))  # what is accepted is sound: it can be sent again
        except DecodeError as error:
            assert error.reason.isidentifier()
            refused += 1
    assert refused > 3_000


def mutate(rng: np.random.Generator, payload: bytes, other: bytes) -> bytes:
    changed = bytearray(payload)
    place = int(rng.integers(0, len(changed)))
    match int(rng.integers(0, 5)):
        case 0:
            changed[place] ^= 1 << int(rng.integers(0, 8))
        case 1:
            del changed[place:]
        case 2:
            changed[place:] = other[int(rng.integers(0, len(other))) :]
        case 3:
            changed[place : place + 4] = rng.bytes(4)
        case _:
            place = int(rng.integers(0, min(24, len(changed))))
            changed[place : place + 4] = struct.pack("<I", int(rng.integers(0, 2**32)))
    return bytes(changed)


def checksum(payload: bytes) -> int:
    sealed = frame.seal(0, b"")
    if len(payload) < len(sealed):
        return 0
    return zlib.crc32(payload[16:], zlib.crc32(payload[:12]))


# Each way of being wrong has a word of its own.


def test_a_wrong_envelope_is_refused_by_reason() -> None:
    payload = encode(push(np.random.default_rng(0)))
    body = payload[16:]
    assert reason(b"") == "short"
    assert reason(b"http" + payload[4:]) == "magic"
    assert reason(frame.seal(1, body, version=9)) == "version"
    assert reason(frame.seal(77, body)) == "kind"
    assert reason(payload + b"\0") == "length"
    assert reason(payload[:-1]) == "length"
    assert reason(payload[:-1] + bytes([payload[-1] ^ 1])) == "checksum"
    assert reason(payload[:5] + b"\x02" + payload[6:]) == "checksum", "the checksum covers the header"
    assert reason(payload, expect=Ack) == "unexpected"
    assert isinstance(decode(payload, expect=(Ack, Push)), Push)


def test_a_compression_bomb_is_refused_before_it_is_inflated(monkeypatch: pytest.MonkeyPatch) -> None:
    deflate = zstandard.ZstdCompressor()
    bomb = frame.seal(1, deflate.compress(bytes(64 * 2**20)))
    undeclared = frame.seal(1, zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1000)))
    small_kind = frame.seal(3, deflate.compress(bytes(5000)))
    monkeypatch.setattr(frame, "_decompressor", lambda: pytest.fail("inflated"))
    assert reason(bomb) == "size"
    assert reason(undeclared) == "size"
    assert reason(small_kind) == "size"


def test_anything_but_one_whole_zstd_frame_is_refused() -> None:
    payload = encode(Ack(1, "a", 0, "low", 0, None))
    body = payload[16:]
    assert reason(frame.seal(3, body + body)) == "zstd"
    assert reason(frame.seal(3, body + b"x")) == "zstd"
    assert reason(frame.seal(3, body[:-1])) == "zstd"
    assert reason(frame.seal(3, b"")) == "zstd"
    content = zstandard.ZstdDecompressor().decompress(body)
    deflate = zstandard.ZstdCompressor()
    assert reason(frame.seal(3, deflate.compress(content + b"x"))) == "trailing"
    assert reason(frame.seal(3, deflate.compress(content[:3]))) == "content"
    assert reason(frame.seal(3, deflate.compress(struct.pack("<I", 999) + b"{}"))) == "content"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"meta": {}, "columns": [], "more": 1}', "meta"),
        ("[1, 2]", "meta"),
        ('{"meta": 3, "columns": []}', "meta"),
        ('{"meta": {"x": NaN}, "columns": []}', "json"),
        ('{"meta": {"x": 1e999}, "columns": []}', "json"),
        ('{"meta": {"x": %s}, "columns": []}' % ("9" * 300), "json"),
        ('{"meta": {"x": %s}, "columns": []}' % ("9" * 9000), "json"),
        ("[" * 100_000, "json"),
        ("not json", "json"),
        ('{"meta": {}, "columns": [["x", "object", [1]]]}', "dtype"),
        ('{"meta": {}, "columns": [["x", "float32", [-1]]]}', "shape"),
        ('{"meta": {}, "columns": [["x", "float32", [true]]]}', "shape"),
        ('{"meta": {}, "columns": [["x", "float32", [4294967295, 4294967295, 4294967295]]]}', "shape"),
        ('{"meta": {}, "columns": [["x", "float32", [1]]]}', "shape"),
        ('{"meta": {}, "columns": [["x", "uint8", []], ["x", "uint8", []]]}', "column"),
        ('{"meta": {}, "columns": [["", "uint8", []]]}', "column"),
        ('{"meta": {}, "columns": [["x", "uint8"]]}', "column"),
        ('{"meta": {}, "columns": [["x", "bool", []]]}', "boolean"),
        (json.dumps({"meta": {}, "columns": [["x", "uint8", []]] * 5000}), "meta"),
    ],
)
def test_a_wrong_description_is_refused_by_reason(text: str, expected: str) -> None:
    content = struct.pack("<I", len(text)) + text.encode() + b"\x07\x07"
    payload = frame.seal(10, zstandard.ZstdCompressor().compress(content))
    assert reason(payload) == expected


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


def test_weights_must_be_finite_float32_under_a_hash() -> None:
    rng = np.random.default_rng(0)

    def sent(sha256: str = "0" * 64, **changes: np.ndarray) -> bytes:
        return encode(WeightsMessage(1, 0, sha256, Weights(Level.LOW, 1, parameters(rng) | changes)))

    assert decode(sent()).weights.parameters["bias"].flags.writeable
    for bad in ({"bias": np.full(8, np.nan, np.float32)}, {"bias": np.zeros(8)}, {"a b": np.zeros(8, np.float32)}):
        with pytest.raises(ProtocolError):
            sent(**bad)
    with pytest.raises(ProtocolError, match="hash"):
        sent("0" * 63)


def test_what_json_would_change_in_silence_is_refused_by_the_sender() -> None:
    for content in ({1: "key"}, {"x": (1, 2)}, {"x": float("nan")}, {"x": np.float32(1)}, {"x": np.int64(1)}):
        with pytest.raises(ProtocolError, match="json"):
            encode(Orders(1, "actor", content))


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
