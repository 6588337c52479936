"""Latest statistics of every role, collected from the messages that any subscriber of a run receives."""

import json
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from operator import itemgetter
from typing import Any

from zsdist.transport.base import Message
from zsdist.types import Level
from zsdist.wire import keys
from zsdist.wire.codec import MAX_COUNT

Fields = dict[str, float | str]
# Fields of statistics that are words; all others are numbers.
WORDS = frozenset(("role", "id", "host", "stage", "states_awaited", "endpoint"))
_NUMBERS = frozenset((int, float))  # as JSON is read; a truth value is none
MAX_BYTES, MAX_ROLES = 65_536, 8192  # size of one message, and number of roles that are kept
_ENDING = ("closing", "saving", "done")  # stages in which a run only ends
HISTORY = 12  # number of a role's last statistics from which its rates are computed

_COMBINE: dict[str, Callable[[Iterable[float]], float]] = {  # over shards; all other fields are summed
    "batch_size": max,
    "oldest_version": min,
    "oldest_age_versions": max,
}


class Snapshot:
    """Latest statistics of each role, and the roles that are alive.

    Attributes:
        roles: statistics by kind of role and id.
        alive: roles that hold a liveliness token.
        events: last 100 events.
        reports: number of statistics that were accepted.
        malformed: number of messages that were not understood, and changed nothing.
        max_lag_versions: largest number of versions by which an actor's weights were behind their learner.
        max_lag_s: longest time for which an actor acted with weights that were out of date.
    """

    def __init__(self) -> None:
        self.roles: dict[tuple[str, str], Fields] = {}
        self.alive: set[tuple[str, str]] = set()
        self.events: list[Fields] = []
        self.reports = 0
        self.malformed = 0
        self.max_lag_versions = 0
        self.max_lag_s = 0.0
        self._history: dict[tuple[str, str], deque[Fields]] = {}

    def update(self, messages: Iterable[Message]) -> None:
        """Accept statistics, events and changes of liveliness."""
        for message in messages:
            parsed = keys.parse(message.key)
            if parsed is None:
                self.malformed += 1
            elif parsed.kind == "alive":
                role = (parsed.fields["role"], parsed.fields["id"])
                if message.payload != b"1":
                    self.alive.discard(role)
                elif len(self.alive) < MAX_ROLES:
                    self.alive.add(role)
            else:
                self._take_json(parsed, message.payload)

    def keep_actors(self, names: Collection[str]) -> None:
        """Forget the statistics of all actors but those of these names: the others' weights stay out of date."""
        for key in [(role, identifier) for role, identifier in self.roles if role == "actor"]:
            if "-".join(key) not in names:
                self._forget(key)

    def _forget(self, key: tuple[str, str]) -> None:
        del self.roles[key]
        self._history.pop(key, None)

    def of(self, role: str) -> dict[str, Fields]:
        """Return the statistics of every instance of a role, by id."""
        found = ((identifier, fields) for (kind, identifier), fields in self.roles.items() if kind == role)
        return dict(sorted(found, key=itemgetter(0)))

    def total(self, role: str, name: str) -> float:
        """Return the sum of a field over a role's instances."""
        return sum(float(fields.get(name, 0)) for fields in self.of(role).values())

    def rate(self, role: str, name: str, identifier: str | None = None) -> float:
        """Return the growth of a counter per second over the last statistics, of all instances of a role or of one."""
        if identifier is not None:
            return _growth(self._history.get((role, identifier)), name)
        return sum((_growth(past, name) for (kind, _), past in self._history.items() if kind == role), 0.0)

    def waits(self) -> list[str]:
        """Return the roles that spent most of the last seconds of training waiting, with the reason."""
        if any(fields.get("stage") in _ENDING for fields in self.of("scheduler").values()):
            return []  # nothing is produced or learned any more
        waits = []
        if self.rate("actor", "waiting_credit_s") > 0.5 * max(1, len(self.of("actor"))):
            waits.append("actors for credit")
        waits += [
            f"learner {level} for data" for level in Level if self.rate("learner", "waiting_data_s", level.value) > 0.5
        ]
        return waits

    def lag_versions(self) -> dict[Level, int]:
        """Return the number of versions by which the oldest weights in use are behind their learner, by level."""
        lags = {}
        for level in Level:
            name, newest = f"{level}_weight_version", self._newest_version(level)
            acting = [_figure(fields, name) for fields in self.of("actor").values() if name in fields]
            lags[level] = max(0, int(newest - min(acting, default=newest)))
        return lags

    def _lags_of(self, actor: Fields) -> list[int]:
        """Return the number of versions by which one actor's weights are behind, for each level."""
        lags = []
        for level in Level:
            name, newest = f"{level}_weight_version", self._newest_version(level)
            lags.append(max(0, int(newest - _figure(actor, name))) if name in actor else 0)
        return lags

    def _newest_version(self, level: Level) -> float:
        return _figure(self.roles.get(("learner", level.value), {}), "weight_version")

    def row(self) -> Fields:
        """Return one flat line of figures for `metrics.jsonl` and TensorBoard."""
        scheduler = next(iter(self.of("scheduler").values()), {})
        row: Fields = {
            name: value for name, value in scheduler.items() if name not in ("role", "id", "host", "pid", "epoch")
        }
        row |= {
            f"actors_{name}": self.total("actor", name) for name in ("env_steps", "cars_driving", "waiting_credit_s")
        }
        row["env_steps_per_s"] = round(self.rate("actor", "env_steps"), 2)
        for level, learner in self.of("learner").items():
            for name in ("learner_updates", "weight_version", "loss", "q_mean", "waiting_data_s", "waiting_reply_s"):
                if name in learner:
                    row[f"{level}_{name}"] = learner[name]
            row[f"{level}_updates_per_s"] = round(self.rate("learner", "learner_updates", level), 2)
        row |= {f"replay_{name}": value for name, value in self._replay().items()}
        for level, lag in self.lag_versions().items():
            row[f"{level}_lag_versions"] = lag
            name = f"{level}_weights_lag_s"
            row[name] = max((float(fields.get(name, 0.0)) for fields in self.of("actor").values()), default=0.0)
        return row

    def _replay(self) -> Fields:
        """Return the statistics of both levels, combined over the shards of the replay."""
        shards = list(self.of("replay").values())
        names = {name: None for shard in shards for name in shard if name.startswith(("high_", "low_"))}
        combined: Fields = {}
        for name in names:
            values = [_figure(shard, name) for shard in shards if name in shard]
            combined[name] = _COMBINE.get(name.partition("_")[2], sum)(values)
        for level in Level:
            if f"{level}_samples_per_insert" in combined:
                sampled, stored = (_figure(combined, f"{level}_{name}") for name in ("sampled", "stored"))
                combined[f"{level}_samples_per_insert"] = round(sampled / max(1, stored), 3)
        return combined

    def _take_json(self, parsed: keys.ParsedKey, payload: bytes) -> None:
        fields = _read(payload)
        role = (parsed.fields.get("role", ""), parsed.fields.get("id", ""))
        if fields is None:
            self.malformed += 1
        elif parsed.kind == "events":
            self.events = [*self.events[-99:], fields]
            key = ("actor", str(fields.get("actor")).removeprefix("actor-"))
            if fields.get("event") == "actor_left" and key in self.roles:
                self._forget(key)
        elif parsed.kind == "stats" and _valid(fields, *role) and (role in self.roles or len(self.roles) < MAX_ROLES):
            if self.roles.get(role, {}).get("epoch") != fields.get("epoch"):
                self._history.pop(role, None)  # from another process, whose counters do not continue these
            self.reports += 1
            self.roles[role] = fields
            self._history.setdefault(role, deque(maxlen=HISTORY)).append(fields)
            if role[0] == "learner":
                self.max_lag_versions = max(self.max_lag_versions, *self.lag_versions().values())
            elif role[0] == "actor":  # only its own lag has changed; the time must not grow with the number of actors
                self.max_lag_versions = max(self.max_lag_versions, *self._lags_of(fields))
            self.max_lag_s = max(self.max_lag_s, float(fields.get("weights_max_lag_s", 0.0)))
        else:
            self.malformed += 1


def _growth(past: Sequence[Fields] | None, name: str) -> float:
    """Return the growth of a counter per second over statistics; 0 where they span no time."""
    span_s = float(past[-1]["time_s"]) - float(past[0]["time_s"]) if past else 0.0
    return (float(past[-1].get(name, 0)) - float(past[0].get(name, 0))) / span_s if past and span_s > 0 else 0.0


def _figure(fields: Fields, name: str) -> float:
    """Return a field that is a number; 0 where it is missing."""
    value = fields.get(name, 0)
    return 0 if isinstance(value, str) else value


def _read(payload: bytes) -> Fields | None:
    """Return a flat JSON object of bounded numbers and short printable words; None where the payload is none."""
    try:
        fields = json.loads(payload) if len(payload) <= MAX_BYTES else None
    except (ValueError, RecursionError):
        return None
    if not isinstance(fields, dict):
        return None
    flat = all(map(keys.is_name, fields)) and all(_is_number(value) or _is_word(value) for value in fields.values())
    return fields if flat else None


def _valid(fields: Fields, role: str, identifier: str) -> bool:
    """Return whether statistics name the role of their key, and all fields but `WORDS` are numbers."""
    named = (fields.get("role"), fields.get("id")) == (role, identifier) and role in keys.ROLES
    return named and "time_s" in fields and all((name in WORDS) == _is_word(value) for name, value in fields.items())


def _is_word(value: object) -> bool:
    return isinstance(value, str) and len(value) <= 200 and value.isprintable()


def _is_number(value: Any) -> bool:
    """Return whether a value is a number, finite and so small that sums of several stay finite."""
    return type(value) in _NUMBERS and abs(value) < MAX_COUNT
