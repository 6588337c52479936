"""Invalid bytes raise `DecodeError` and nothing else, with a reason for each kind of fault."""

import json
import struct
import zlib

import numpy as np
import pytest
import zstandard
from wire_messages import every_message, plain, push, reason

from zsdist.errors import DecodeError
from zsdist.wire import frame
from zsdist.wire.codec import decode, encode
from zsdist.wire.messages import Ack, Push


def test_ten_thousand_mutated_frames_raise_only_decode_error_or_are_equal() -> None:
    rng = np.random.default_rng(7)
    messages = every_message(rng)
    frames = [encode(message) for message in messages]
    expected = [plain(message) for message in messages]
    refused = 0
    for number in range(10_000):
        which = number % len(frames)
        payload = mutate(rng, frames[which], frames[(which + 1) % len(frames)])
        if number % 2:  # with a corrected checksum, so that the code behind it is reached
            payload = payload[:12] + struct.pack("<I", checksum(payload)) + payload[16:]
        try:
            decoded = decode(payload)
        except DecodeError as error:
            assert error.reason.isidentifier()
            refused += 1
        else:
            assert number % 2 or plain(decoded) == expected[which]
    assert refused > 8_000


def test_mutated_contents_in_a_valid_frame_raise_only_decode_error_or_are_valid() -> None:
    rng = np.random.default_rng(8)
    frames = [encode(message) for message in every_message(rng)]
    refused = 0
    for number in range(6_000):
        payload = frames[number % len(frames)]
        changed = mutate(rng, content(payload), content(frames[(number + 1) % len(frames)]))
        changed = frame.seal(frame.read_kind(payload), changed, frame.PLAIN)
        try:
            encode(decode(changed))  # an accepted message is valid: it can be sent again
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


def content(payload: bytes) -> bytes:
    body = payload[16:]
    return body if payload[6] == frame.PLAIN else zstandard.ZstdDecompressor().decompress(body)


def checksum(payload: bytes) -> int:
    sealed = frame.seal(0, b"")
    if len(payload) < len(sealed):
        return 0
    return zlib.crc32(payload[16:], zlib.crc32(payload[:12]))


def test_a_wrong_header_is_refused_by_reason() -> None:
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


def test_content_of_a_wrong_length_or_with_wrong_padding_is_refused() -> None:
    sound = content(encode(Ack(1, "a", 0, "low", 0, None)))
    assert reason(frame.seal(3, sound + b"x", frame.PLAIN)) == "trailing"
    assert reason(frame.seal(3, sound[:3], frame.PLAIN)) == "content"
    assert reason(frame.seal(3, struct.pack("<I", 999) + b"{}", frame.PLAIN)) == "content"
    assert reason(described('{"meta": {}, "columns": []}', aligned=False)) == "alignment"
    assert (
        reason(described('{"meta": {}, "columns": [["x", "uint8", [1]]]}', b"\x07" + bytes(6) + b"\x01")) == "padding"
    )


def test_plain_content_has_the_same_limit_and_an_unknown_packing_is_refused() -> None:
    assert reason(frame.seal(3, bytes(5000), frame.PLAIN)) == "size"
    assert reason(frame.seal(3, bytes(16), 2)) == "header"


def described(text: str, columns: bytes = b"", *, aligned: bool = True) -> bytes:
    """Return a checkpoint with a forged description of its columns."""
    padded = text.encode() + b" " * (-(4 + len(text)) % 8 + (not aligned))
    return frame.seal(10, struct.pack("<I", len(padded)) + padded + columns, frame.PLAIN)


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
        ('{"meta": {}, "columns": [["x", "float32", [3]]]}', "shape"),
        ('{"meta": {}, "columns": [["x", "uint8", []], ["x", "uint8", []]]}', "column"),
        ('{"meta": {}, "columns": [["", "uint8", []]]}', "column"),
        ('{"meta": {}, "columns": [["x", "uint8"]]}', "column"),
        ('{"meta": {}, "columns": [["x", "bool", []]]}', "boolean"),
        (json.dumps({"meta": {}, "columns": [["x", "uint8", []]] * 5000}), "meta"),
    ],
)
def test_a_wrong_description_is_refused_by_reason(text: str, expected: str) -> None:
    assert reason(described(text, b"\x07" + bytes(7))) == expected
