"""Check that a message arrived under the key that belongs to its sender.

A hub with certificates lets each certificate use only certain keys. So the sender that a message names can be trusted
if the key agrees with it.
"""

from collections.abc import Callable, Mapping
from typing import Any

from zsdist.errors import DecodeError
from zsdist.types import Ack
from zsdist.wire import keys
from zsdist.wire.messages import (
    EPISODES,
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


def require(key: str, run: str, message: AnyMessage) -> None:
    """Raise `DecodeError` with the reason `key` unless `message` may be sent under `key` in the run `run`."""
    parsed = keys.parse(key)
    kind, fields = _ADDRESSES[type(message)](message)
    if parsed is None or (parsed.run, parsed.kind) != (run, kind):
        raise DecodeError("key", f"a {type(message).__name__} under {key}"[:200])
    for name, value in fields.items():
        if parsed.fields[name] != str(value):
            raise DecodeError("key", f"a {type(message).__name__} with {name} {value} under {key}"[:200])


def _of_records(message: Records) -> tuple[str, dict[str, Any]]:
    """Return the kind of key for records, and its fields."""
    if message.stream == EPISODES:
        return "episodes", {"actor": message.actor, "epoch": message.epoch}
    return "evaluation", {"actor": message.actor}


_ADDRESSES: Mapping[type, Callable[[Any], tuple[str, dict[str, Any]]]] = {
    Push: lambda push: ("push", {"level": push.stream, "actor": push.actor, "epoch": push.epoch}),
    Records: _of_records,
    Ack: lambda ack: ("ack", {"actor": ack.actor}),
    SampleRequest: lambda request: ("sample", {"level": request.level}),
    SampleReply: lambda reply: ("sample", {"level": reply.level}),
    Priorities: lambda priorities: ("priority", {"level": priorities.level}),
    WeightsMessage: lambda message: ("weights", {"level": message.weights.level}),
    Candidate: lambda candidate: ("candidate", {"level": candidate.level, "id": candidate.name}),
    Orders: lambda orders: ("control", {"role": orders.role}),
    Jobs: lambda jobs: ("evaluation", {"actor": jobs.actor}),
    Admission: lambda admission: ("join", {"actor": admission.actor}),
    State: lambda state: ("control", {"role": state.role}),
}
