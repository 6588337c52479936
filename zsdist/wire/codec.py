"""Conversion of messages to bytes and back, without pickle.

For any bytes, `decode` returns a valid message or raises `DecodeError`, and nothing else. `encode` checks the same
rules, so that nothing is sent that its receiver refuses.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, overload

import numpy as np

from zsdist.errors import DecodeError, ProtocolError
from zsdist.types import MAX_REASON, Level, Weights
from zsdist.wire import columns as column_codec
from zsdist.wire import frame, keys
from zsdist.wire.messages import (
    EPISODES,
    EVALUATION,
    MAX_BATCHES,
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

Meta = dict[str, Any]
Columns = dict[str, np.ndarray]
Expected = TypeVar("Expected", bound=AnyMessage)

MIB = 2**20
MAX_COUNT = 2**62  # upper bound, excluded, of sequence numbers, totals, epochs and versions
_LEVELS = tuple(str(level) for level in Level)
_RECORD_STREAMS = (EPISODES, EVALUATION)
_PARAMETER = re.compile(r"[A-Za-z0-9._/-]{1,200}")


@dataclass(frozen=True)
class _Kind:
    """Encoding of one type of message.

    Attributes:
        number: number of the type on the wire.
        limit: most bytes of the content after decompression.
        split: function that returns the JSON fields and columns of a message.
        check: function that raises `DecodeError` unless fields and columns are valid.
        build: function that returns the message from fields and columns that have passed `check`.
        packing: packing of the content, see `zsdist.wire.frame`.
    """

    number: int
    limit: int
    split: Callable[[Any], tuple[Meta, Columns]]
    check: Callable[[Meta, Columns], None]
    build: Callable[[Meta, Columns], AnyMessage]
    packing: int = frame.ZSTD


def encode(message: AnyMessage, *, packing: int | None = None) -> bytes:
    """Return the bytes of a message.

    Args:
        message: message to send.
        packing: `PLAIN` or `ZSTD` of `zsdist.wire.frame`; None: the packing of its type.

    Raises:
        ProtocolError: `decode` would refuse the message.
    """
    kind = _KINDS[type(message)]
    try:
        meta, columns = kind.split(message)
        kind.check(meta, columns)
        return frame.pack(kind.number, meta, columns, kind.limit, kind.packing if packing is None else packing)
    except DecodeError as error:
        raise ProtocolError(f"{type(message).__name__} cannot be sent: {error}") from error


@overload
def decode(payload: bytes, *, expect: type[Expected] | tuple[type[Expected], ...]) -> Expected: ...


@overload
def decode(payload: bytes, *, expect: None = None) -> AnyMessage: ...


def decode(payload: bytes, *, expect: type | tuple[type, ...] | None = None) -> AnyMessage:
    """Return the message in `payload`; its arrays share no memory with others and may be written to.

    Args:
        payload: any bytes.
        expect: allowed types of message; others are refused before decompression; None: all types.

    Raises:
        DecodeError: the bytes are not a valid message; `reason` gives the reason in a word.
    """
    message_type = type_of(payload)
    if expect is not None and not issubclass(message_type, expect):
        raise DecodeError("unexpected", message_type.__name__)
    kind = _KINDS[message_type]
    meta, columns = frame.unpack(payload, kind.limit)
    kind.check(meta, columns)
    return kind.build(meta, columns)


def type_of(payload: bytes) -> type[AnyMessage]:
    """Return the type of a message without decoding it; raise `DecodeError` where its header or checksum is wrong."""
    number = frame.read_kind(payload)
    if number not in _BY_NUMBER:
        raise DecodeError("kind", str(number))
    return _BY_NUMBER[number]


# Checks of single fields. All raise `DecodeError`.


def _fields(meta: Meta, *names: str) -> None:
    if set(meta) != set(names):
        raise DecodeError("field", ", ".join(sorted(set(meta) ^ set(names)))[:120])


def _counts(meta: Meta, *names: str) -> None:
    for name in names:
        value = meta[name]
        if type(value) is not int or not 0 <= value < MAX_COUNT:
            raise DecodeError("count", f"{name} is {value!r}"[:80])


def _seconds(meta: Meta, name: str) -> None:
    value = meta[name]
    if type(value) not in (int, float) or not 0 <= value < MAX_COUNT:
        raise DecodeError("time", f"{name} is {value!r}"[:80])


def _names(meta: Meta, *names: str) -> None:
    for name in names:
        if not isinstance(meta[name], str) or not keys.is_name(meta[name]):
            raise DecodeError("name", f"{name} is {meta[name]!r}"[:80])


def _one_of(meta: Meta, name: str, allowed: tuple[str, ...]) -> None:
    if meta[name] not in allowed:
        raise DecodeError(name, f"{meta[name]!r}"[:80])


def _json_object(meta: Meta, name: str) -> None:
    if not isinstance(meta[name], dict):
        raise DecodeError("field", f"{name} is not a JSON object")


def _batches(meta: Meta, rows: int) -> None:
    if not 1 <= meta["batches"] <= MAX_BATCHES or rows % meta["batches"]:
        raise DecodeError("batches", f"{meta['batches']} of {rows} rows")


def _no_columns(columns: Columns) -> None:
    column_codec.require_columns(columns, {})


def _parameters(columns: Columns) -> None:
    if not columns:
        raise DecodeError("column", "no parameters")
    for name, column in columns.items():
        if _PARAMETER.fullmatch(name) is None:
            raise DecodeError("name", f"parameter {name!r}"[:80])
        if column.dtype != np.float32:
            raise DecodeError("dtype", f"parameter {name!r} is {column.dtype}; allowed is float32")
        column_codec.require_finite(column, name)


# The functions `split`, `check` and `build` of each type of message.

_NUMBERED = ("stream", "actor", "epoch", "sequence", "produced", "closes")


def _numbered(message: Push | Records) -> Meta:
    return {name: getattr(message, name) for name in _NUMBERED} | {"stream": str(message.stream)}


def _check_numbered(meta: Meta, count: int) -> None:
    _names(meta, "actor")
    _counts(meta, "epoch", "sequence", "produced")
    if type(meta["closes"]) is not bool:
        raise DecodeError("field", "closes is not a boolean")
    if not count and not meta["closes"]:
        raise DecodeError("empty", "only a closing frame may be empty")
    if meta["produced"] < count:
        raise DecodeError("total", f"{meta['produced']} produced, {count} in this frame")


def _split_push(message: Push) -> tuple[Meta, Columns]:
    columns, actions = column_codec.from_trajectories(message.trajectories, message.stream)
    return _numbered(message) | {"actions": actions} | ({"first": True} if message.first else {}), columns


def _check_push(meta: Meta, columns: Columns) -> None:
    _fields(meta, *_NUMBERED, "actions", *({"first"} & set(meta)))
    if meta.get("first", True) is not True:
        raise DecodeError("field", "first is not true")
    _one_of(meta, "stream", _LEVELS)
    _counts(meta, "actions")
    _check_numbered(meta, column_codec.check_trajectories(columns, meta["actions"]))


def _build_push(meta: Meta, columns: Columns) -> Push:
    level = Level(meta["stream"])
    trajectories = column_codec.to_trajectories(columns, meta["actions"], level)
    numbered = {name: meta[name] for name in _NUMBERED} | {"stream": level}
    return Push(**numbered, trajectories=trajectories, first="first" in meta)


def _split_records(message: Records) -> tuple[Meta, Columns]:
    return _numbered(message) | {"records": list(message.records)}, {}


def _check_records(meta: Meta, columns: Columns) -> None:
    _no_columns(columns)
    _fields(meta, *_NUMBERED, "records")
    _one_of(meta, "stream", _RECORD_STREAMS)
    if not isinstance(meta["records"], list) or not all(isinstance(record, dict) for record in meta["records"]):
        raise DecodeError("field", "records are not a list of JSON objects")
    _check_numbered(meta, len(meta["records"]))


def _build_records(meta: Meta, columns: Columns) -> Records:
    return Records(**meta | {"records": tuple(meta["records"])})


def _check_ack(meta: Meta, columns: Columns) -> None:
    _no_columns(columns)
    _fields(meta, "sender_epoch", "actor", "epoch", "stream", "received", "credit", "refused")
    _names(meta, "actor")
    _one_of(meta, "stream", _LEVELS + _RECORD_STREAMS)
    _counts(meta, "sender_epoch", "epoch", "received", *(() if meta["credit"] is None else ("credit",)))
    refused = meta["refused"]
    if not isinstance(refused, str) or len(refused) > MAX_REASON or not refused.isprintable():
        raise DecodeError("field", f"refused is not printable text of at most {MAX_REASON} characters")


def _check_sample_request(meta: Meta, columns: Columns) -> None:
    _no_columns(columns)
    _fields(meta, "sender_epoch", "level", "updates", "batches")
    _one_of(meta, "level", _LEVELS)
    _counts(meta, "sender_epoch", "updates", "batches")
    _batches(meta, 0)


def _build_sample_request(meta: Meta, columns: Columns) -> SampleRequest:
    return SampleRequest(**meta | {"level": Level(meta["level"])})


def _split_sample_reply(message: SampleReply) -> tuple[Meta, Columns]:
    columns, actions = ({}, 0) if message.batch is None else column_codec.from_batch(message.batch)
    meta = {"level": str(message.level), "held": message.held, "waited_s": message.waited_s}
    return meta | {"batches": message.batches, "actions": actions}, columns


def _check_sample_reply(meta: Meta, columns: Columns) -> None:
    _fields(meta, "level", "held", "waited_s", "batches", "actions")
    _one_of(meta, "level", _LEVELS)
    _counts(meta, "held", "batches", "actions")
    _seconds(meta, "waited_s")
    if columns:
        column_codec.check_batch(columns, meta["actions"])
        _batches(meta, len(columns["actions"]))
    elif meta["actions"]:
        raise DecodeError("actions", "number of actions without a batch")


def _build_sample_reply(meta: Meta, columns: Columns) -> SampleReply:
    batch = column_codec.to_batch(columns, meta["actions"]) if columns else None
    return SampleReply(Level(meta["level"]), batch, meta["held"], meta["waited_s"], meta["batches"])


def _split_priorities(message: Priorities) -> tuple[Meta, Columns]:
    meta = {"sender_epoch": message.sender_epoch, "level": str(message.level)}
    return meta, {"serials": message.serials, "errors": message.errors}


def _check_priorities(meta: Meta, columns: Columns) -> None:
    _fields(meta, "sender_epoch", "level")
    _counts(meta, "sender_epoch")
    _one_of(meta, "level", _LEVELS)
    column_codec.check_priorities(columns)


def _build_priorities(meta: Meta, columns: Columns) -> Priorities:
    return Priorities(meta["sender_epoch"], Level(meta["level"]), columns["serials"], columns["errors"])


def _split_weights(message: WeightsMessage) -> tuple[Meta, Columns]:
    weights = message.weights
    meta = {name: getattr(message, name) for name in ("sender_epoch", "merge", "sha256", "made_s")}
    return meta | {"level": str(weights.level), "version": weights.version}, weights.parameters


def _check_weights(meta: Meta, columns: Columns) -> None:
    _fields(meta, "sender_epoch", "merge", "sha256", "made_s", "level", "version")
    _counts(meta, "sender_epoch", "merge", "version")
    _seconds(meta, "made_s")
    _one_of(meta, "level", _LEVELS)
    if not isinstance(meta["sha256"], str) or re.fullmatch("[0-9a-f]{64}", meta["sha256"]) is None:
        raise DecodeError("hash", f"{meta['sha256']!r}"[:80])
    _parameters(columns)


def _build_weights(meta: Meta, columns: Columns) -> WeightsMessage:
    weights = Weights(Level(meta["level"]), meta["version"], columns)
    return WeightsMessage(meta["sender_epoch"], meta["merge"], meta["sha256"], meta["made_s"], weights)


def _split_candidate(message: Candidate) -> tuple[Meta, Columns]:
    meta = {"sender_epoch": message.sender_epoch, "level": str(message.level)}
    return meta | {"merge": message.merge, "name": message.name}, message.parameters


def _check_candidate(meta: Meta, columns: Columns) -> None:
    _fields(meta, "sender_epoch", "level", "merge", "name")
    _counts(meta, "sender_epoch", "merge")
    _one_of(meta, "level", _LEVELS)
    _names(meta, "name")
    _parameters(columns)


def _build_candidate(meta: Meta, columns: Columns) -> Candidate:
    return Candidate(**meta | {"level": Level(meta["level"])}, parameters=columns)


def _check_orders(meta: Meta, columns: Columns) -> None:
    _no_columns(columns)
    _fields(meta, "sender_epoch", "role", "content")
    _counts(meta, "sender_epoch")
    _names(meta, "role")
    _json_object(meta, "content")


def _check_jobs(meta: Meta, columns: Columns) -> None:
    _no_columns(columns)
    _fields(meta, "sender_epoch", "actor", "content")
    _counts(meta, "sender_epoch")
    _names(meta, "actor")
    _json_object(meta, "content")


def _check_admission(meta: Meta, columns: Columns) -> None:
    _no_columns(columns)
    _fields(meta, "actor", "content")
    _names(meta, "actor")
    _json_object(meta, "content")


def _split_state(message: State) -> tuple[Meta, Columns]:
    return {"role": message.role, "meta": message.meta}, message.arrays


def _check_state(meta: Meta, columns: Columns) -> None:
    _fields(meta, "role", "meta")
    _names(meta, "role")
    _json_object(meta, "meta")
    for name in columns:
        if _PARAMETER.fullmatch(name) is None:
            raise DecodeError("name", f"array {name!r}"[:80])


def _build_state(meta: Meta, columns: Columns) -> State:
    return State(meta["role"], meta["meta"], columns)


def _plain(message: AnyMessage) -> tuple[Meta, Columns]:
    """Return the fields of a message that has no arrays."""
    return {name: str(value) if isinstance(value, Level) else value for name, value in vars(message).items()}, {}


_KINDS: Mapping[type, _Kind] = {
    Push: _Kind(1, 16 * MIB, _split_push, _check_push, _build_push),
    Records: _Kind(2, 4 * MIB, _split_records, _check_records, _build_records),
    Ack: _Kind(3, 4096, _plain, _check_ack, lambda meta, columns: Ack(**meta)),
    SampleRequest: _Kind(4, 4096, _plain, _check_sample_request, _build_sample_request),
    # Not compressed: random rows shrink by a third only, and compression takes longer than the rest of the reply.
    SampleReply: _Kind(5, 64 * MIB, _split_sample_reply, _check_sample_reply, _build_sample_reply, frame.PLAIN),
    WeightsMessage: _Kind(6, 256 * MIB, _split_weights, _check_weights, _build_weights),
    Candidate: _Kind(7, 256 * MIB, _split_candidate, _check_candidate, _build_candidate),
    Orders: _Kind(8, 16 * MIB, _plain, _check_orders, lambda meta, columns: Orders(**meta)),
    Jobs: _Kind(9, 16 * MIB, _plain, _check_jobs, lambda meta, columns: Jobs(**meta)),
    State: _Kind(10, 2048 * MIB, _split_state, _check_state, _build_state),
    Priorities: _Kind(11, MIB, _split_priorities, _check_priorities, _build_priorities, frame.PLAIN),
    Admission: _Kind(12, MIB, _plain, _check_admission, lambda meta, columns: Admission(**meta)),
}
_BY_NUMBER = {kind.number: message_type for message_type, kind in _KINDS.items()}
