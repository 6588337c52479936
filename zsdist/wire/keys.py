"""Keys under which the messages of a run are sent. Every key begins with `zsdist/{run}/`.

A role is named by its kind, such as `actor`, and its id, a number or a level: `actor` and `3`, `learner` and `low`. A
field called `actor` holds both, `actor-3`. A function that gets `ANY` in place of a name returns a pattern that matches
all names.
"""

import re
from functools import lru_cache
from typing import NamedTuple

from zsdist.errors import ProtocolError
from zsdist.types import Level

ROOT = "zsdist"
ANY = "*"
ROLES = ("actor", "replay", "learner", "scheduler", "hub", "monitor")
_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")

# Fields that follow `zsdist/{run}/{kind}/`, by kind.
_FORMS: dict[str, tuple[str, ...]] = {
    "push": ("level", "actor", "epoch"),
    "episodes": ("actor", "epoch"),
    "ack": ("actor",),
    "sample": ("level",),
    "priority": ("level",),
    "weights": ("level",),
    "candidate": ("level", "id"),
    "evaluation": ("actor",),
    "control": ("role",),
    "stats": ("role", "id"),
    "events": (),
    "alive": ("role", "id"),
    "join": ("actor",),
    "view": ("actor", "car"),
}
_SHARDED = (
    "sample",
    "priority",
)  # may have one more field: the number of a shard of the replay, from 1


class ParsedKey(NamedTuple):
    """Parts of a key; `fields` holds the names after its `kind`, such as `{"level": "low", "actor": "actor-0"}`."""

    run: str
    kind: str
    fields: dict[str, str]


@lru_cache(maxsize=4096)  # watchers ask for each field of each message
def is_name(text: str) -> bool:
    """Return whether `text` may be a part of a key: 1 to 64 letters, digits, `.`, `_`, `-`."""
    return _NAME.fullmatch(text) is not None


def push(run: str, level: Level | str, actor: str, epoch: int | str) -> str:
    """Return the key of the trajectories of one actor and level, actor to replay."""
    return _join(run, "push", level, actor, epoch)


def episodes(run: str, actor: str, epoch: int | str) -> str:
    """Return the key of an actor's records of finished episodes, actor to scheduler."""
    return _join(run, "episodes", actor, epoch)


def ack(run: str, actor: str) -> str:
    """Return the key of acknowledgements and credit for all streams of an actor, receivers to actor."""
    return _join(run, "ack", actor)


def sample(run: str, level: Level | str, shard: int | str = 0) -> str:
    """Return the key of requests for batches to a shard of the replay; shard 0 has the key of an unsharded replay."""
    return _join(run, "sample", level, *((shard,) if shard else ()))


def priority(run: str, level: Level | str, shard: int | str = 0) -> str:
    """Return the key of the priorities of sampled transitions, learner to a shard of the replay."""
    return _join(run, "priority", level, *((shard,) if shard else ()))


def weights(run: str, level: Level | str) -> str:
    """Return the key of the newest weights of a level; retained."""
    return _join(run, "weights", level)


def candidate(run: str, level: Level | str, name: str) -> str:
    """Return the key of the newest candidate of this name, such as `recent`; retained.

    The number of its merge is in the message alone. A key for each merge would keep the parameters of all merges.
    """
    return _join(run, "candidate", level, name)


def evaluation(run: str, actor: str) -> str:
    """Return the key of an actor's jobs, scheduler to actor, and of the results of its drives, actor to scheduler."""
    return _join(run, "evaluation", actor)


def control(run: str, role: str) -> str:
    """Return the key of orders to `role`: a kind of role, such as `actor`, or a single one, such as `learner-low`."""
    return _join(run, "control", role)


def stats(run: str, role: str, identifier: str) -> str:
    """Return the key of a role's statistics, which are JSON and sent at least once a second."""
    return _join(run, "stats", role, identifier)


def events(run: str) -> str:
    """Return the key of events for the log, which are JSON."""
    return _join(run, "events")


def alive(run: str, role: str, identifier: str) -> str:
    """Return the key of the liveliness token of a role."""
    return _join(run, "alive", role, identifier)


def join(run: str, actor: str) -> str:
    """Return the key of the questions of an actor that joins a run from elsewhere, actor to runner."""
    return _join(run, "join", actor)


def view(run: str, actor: str, car: int | str) -> str:
    """Return the key of questions about what a car sees and believes, watcher to actor; car `all`: where all are."""
    return _join(run, "view", actor, car)


def parse(key: str) -> ParsedKey | None:
    """Return the parts of a key; None if it is malformed or belongs to another program."""
    parts = key.split("/")
    if len(parts) < 3 or parts[0] != ROOT or parts[2] not in _FORMS or not all(map(is_name, parts[1:])):
        return None
    form = _form(parts[2], len(parts) - 3)
    fields = dict(zip(form, parts[3:], strict=False))
    if len(parts) != 3 + len(form) or _wrong_field(fields) is not None:
        return None
    return ParsedKey(parts[1], parts[2], fields)


def _form(kind: str, length: int) -> tuple[str, ...]:
    """Return the names of the fields of a key of this kind with this many fields."""
    form = _FORMS[kind]
    return (*form, "shard") if kind in _SHARDED and length == len(form) + 1 else form


def _join(run: str, kind: str, *values: str | int) -> str:
    """Return a key; raise `ProtocolError` if a part is not allowed."""
    fields = dict(zip(_form(kind, len(values)), map(str, values), strict=True))
    for name, value in {"run": run, **fields}.items():
        if value != ANY and not is_name(value):
            raise ProtocolError(f"key part {name} is {value!r}; allowed are 1 to 64 letters, digits, '.', '_', '-'")
    named = {name: value for name, value in fields.items() if value != ANY}
    if (wrong := _wrong_field(named)) is not None:
        raise ProtocolError(f"key part {wrong} is {named[wrong]!r}; allowed is {_ALLOWED[wrong]}")
    return "/".join((ROOT, run, kind, *fields.values()))


_ALLOWED = {
    "level": "high or low",
    "epoch": "a whole number from 0 without leading zeros",
    "shard": "a whole number from 1 without leading zeros",
}


def _wrong_field(fields: dict[str, str]) -> str | None:
    """Return the name of a field whose value is not allowed; None if all are."""
    if "level" in fields and fields["level"] not in tuple(Level):
        return "level"
    for name, form in (("epoch", r"0|[1-9][0-9]{0,17}"), ("shard", r"[1-9][0-9]{0,3}")):
        if name in fields and not re.fullmatch(form, fields[name]):
            return name
    return None
