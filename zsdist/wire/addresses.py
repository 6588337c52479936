"""Whether a message came under a key that is its own.

A hub that asks for certificates binds keys to them, so what a message says of its sender holds only as far as its key
says the same.
"""

from collections.abc import Callable, Mapping
from typing import Any

from zsdist.errors import DecodeError
from zsdist.types import Ack
from zsdist.wire import keys
from zsdist.wire.messages import (
    EPISODES,
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
    """Raises `DecodeError` with the reason `key` unless `message` may travel under `key` in the run of this name."""
    parsed = keys.parse(key)
    kind, fields = _ADDRESSES[type(message)](message)
    if parsed is None or (parsed.run, parsed.kind) != (run, kind):
        raise DecodeError("key", f"a {type(message).__name__} under {key}"[:200])
    for name, value in fields.items():
        if parsed.fields[name] != str(value):
            raise DecodeError("key", f"a {type(message).__name__} with {name} {value} under {key}"[:200])


def _of_records(message: Records) -> tuple[str, dict[str, Any]]:
    if message.stream == EPISODES:
        return "episodes", {"actor": message.actor, "epoch": message.epoch}
    return "evaluation", {"actor": message.actor}


_ADDRESSES: Mapping[type, Callable[[Any], tuple[str, dict[str, Any]]]] = {
    Push: lambda push: ("push", {"level": push.stream, "actor": push.actor, "epoch": push.epoch}),
    Records: _of_records,
    Ack: lambda ack: ("ack", {"actor": ack.actor}),
    SampleRequest: lambda request: ("sample", {"level": request.level}),
    SampleReply: lambda reply: ("sample", {"level": reply.level}),
    Priorities: lambda found: ("priority", {"level": found.level}),
    WeightsMessage: lambda message: ("weights", {"level": message.weights.level}),
    Candidate: lambda one: ("candidate", {"level": one.level, "id": f"{one.merge}-{one.name}"}),
    Orders: lambda orders: ("control", {"role": orders.role}),
    Jobs: lambda jobs: ("evaluation", {"actor": jobs.actor}),
    State: lambda state: ("control", {"role": state.role}),
}
