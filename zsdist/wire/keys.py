"""The key space of a run: where each message travels. Every key begins with `zsdist/{run}/`.

A key function given `ANY` in place of a name gives the pattern over all of them.
"""

import re
from typing import NamedTuple

from zsdist.errors import ProtocolError
from zsdist.types import Level

ROOT = "zsdist"
ANY = "*"
ROLES = ("actor", "replay", "learner", "scheduler", "hub", "monitor")
_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")

# Parts after `zsdist/{run}/`. Names in braces are fields of a parsed key.
_FORMS = {
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
}
_SHARDED = ("sample", "priority")  # these may have one part more: the number of a replay's further shard


class ParsedKey(NamedTuple):
    """A key taken apart: `fields` holds the names after its `kind`, such as `{"level": "low", "actor": "a0"}`."""

    run: str
    kind: str
    fields: dict[str, str]


def is_name(text: str) -> bool:
    """Whether `text` may stand in a key: 1 to 64 letters, digits, `.`, `_`, `-`."""
    return _NAME.fullmatch(text) is not None


def push(run: str, level: Level | str, actor: str, epoch: int | str) -> str:
    """Trajectories of one actor and level, to the replay."""
    return _join(run, "push", level, actor, epoch)


def episodes(run: str, actor: str, epoch: int | str) -> str:
    """How each episode of an actor ended, to the scheduler."""
    return _join(run, "episodes", actor, epoch)


def ack(run: str, actor: str) -> str:
    """Acknowledgements and credit of all streams of an actor."""
    return _join(run, "ack", actor)


def sample(run: str, level: Level | str, shard: int = 0) -> str:
    """Requests for batches, answered by a shard of the replay; the first has the key that a single one has."""
    return _join(run, "sample", level, *((shard,) if shard else ()))


def priority(run: str, level: Level | str, shard: int = 0) -> str:
    """Priorities of sampled transitions, learner to a shard of the replay."""
    return _join(run, "priority", level, *((shard,) if shard else ()))


def weights(run: str, level: Level | str) -> str:
    """The newest weights of a level; retained."""
    return _join(run, "weights", level)


def candidate(run: str, level: Level | str, name: str) -> str:
    """Parameters that stand for promotion; retained."""
    return _join(run, "candidate", level, name)


def evaluation(run: str, actor: str) -> str:
    """Jobs for greedy drives (scheduler to actor) and their results (actor to scheduler)."""
    return _join(run, "evaluation", actor)


def control(run: str, role: str) -> str:
    """Return the key of orders to `role`: a kind of role, such as `actor`, or a single one, such as `learner-low`."""
    return _join(run, "control", role)


def stats(run: str, role: str, identifier: str) -> str:
    """Statistics, JSON, at least once a second."""
    return _join(run, "stats", role, identifier)


def events(run: str) -> str:
    """Events worth a line, JSON."""
    return _join(run, "events")


def alive(run: str, role: str, identifier: str) -> str:
    """Liveliness token of one role."""
    return _join(run, "alive", role, identifier)


def parse(key: str) -> ParsedKey | None:
    """A key taken apart; None where it is not of this key space (someone else's, or malformed)."""
    parts = key.split("/")
    if len(parts) < 3 or parts[0] != ROOT or parts[2] not in _FORMS or not all(map(is_name, parts[1:])):
        return None
    form = _form(parts[2], len(parts) - 3)
    fields = dict(zip(form, parts[3:], strict=False))
    if len(parts) != 3 + len(form) or _misfit(fields) is not None:
        return None
    return ParsedKey(parts[1], parts[2], fields)


def _form(kind: str, length: int) -> tuple[str, ...]:
    """The names of the parts of a key of this kind that has so many."""
    form = _FORMS[kind]
    return (*form, "shard") if kind in _SHARDED and length == len(form) + 1 else form


def _join(run: str, kind: str, *values: str | int) -> str:
    fields = dict(zip(_form(kind, len(values)), map(str, values), strict=True))
    for name, value in {"run": run, **fields}.items():
        if value != ANY and not is_name(value):
            raise ProtocolError(f"key part {name} is {value!r}; allowed are 1 to 64 letters, digits, '.', '_', '-'")
    named = {name: value for name, value in fields.items() if value != ANY}
    if (misfit := _misfit(named)) is not None:
        raise ProtocolError(f"key part {misfit} is {named[misfit]!r}; allowed is {_ALLOWED[misfit]}")
    return "/".join((ROOT, run, kind, *fields.values()))


_ALLOWED = {
    "level": "high or low",
    "epoch": "a whole number from 0 without leading zeros",
    "shard": "a whole number from 1 without leading zeros",
}


def _misfit(fields: dict[str, str]) -> str | None:
    if "level" in fields and fields["level"] not in tuple(Level):
        return "level"
    for name, form in (("epoch", r"0|[1-9][0-9]{0,17}"), ("shard", r"[1-9][0-9]{0,3}")):
        if name in fields and not re.fullmatch(form, fields[name]):
            return name
    return None
