"""The latest statistics of every role, as anybody who subscribes to a run can put them together."""

import json
from collections import deque
from collections.abc import Iterable

from zsdist.transport.base import Message
from zsdist.types import Level
from zsdist.wire import keys
from zsdist.wire.codec import MAX_COUNT

Fields = dict[str, float | str]
WORDS = ("role", "id", "host", "stage", "endpoint")  # fields of statistics that are no numbers
_TOGETHER = {"batch_size": max, "oldest_version": min, "oldest_age_versions": max}  # of shards; all others add up
MAX_BYTES, MAX_ROLES = 65_536, 8192  # of one statement, and of those who speak
HISTORY = 12  # statistics of a role that its rates are taken over


class Snapshot:
    """Who is alive and what they last said; `take` swallows anything malformed by counting it in `malformed`."""

    def __init__(self) -> None:
        self.roles: dict[tuple[str, str], Fields] = {}
        self.alive: set[tuple[str, str]] = set()
        self.events: list[Fields] = []
        self.malformed = 0
        self.max_lag_versions = 0
        self.max_lag_s = 0.0  # longest that an actor acted with weights that were out of date
        self._history: dict[tuple[str, str], deque[Fields]] = {}

    def take(self, messages: Iterable[Message]) -> None:
        """Takes statistics, events and liveliness changes in."""
        for message in messages:
            parsed = keys.parse(message.key)
            if parsed is None:
                self.malformed += 1
            elif parsed.kind == "alive":
                who = (parsed.fields["role"], parsed.fields["id"])
                if message.payload != b"1":
                    self.alive.discard(who)
                elif len(self.alive) < MAX_ROLES:
                    self.alive.add(who)
            else:
                self._take_json(parsed, message.payload)

    def of(self, role: str) -> dict[str, Fields]:
        """Statistics of every instance of a role, by id."""
        return {identifier: fields for (kind, identifier), fields in sorted(self.roles.items()) if kind == role}

    def total(self, role: str, name: str) -> float:
        """Sum of a field over a role's instances."""
        return sum(float(fields.get(name, 0)) for fields in self.of(role).values())

    def rate(self, role: str, name: str, identifier: str | None = None) -> float:
        """Growth of a counter a second over the last statistics, summed over a role's instances (or of one)."""
        total = 0.0
        for (kind, one), past in self._history.items():
            span_s = float(past[-1]["time_s"]) - float(past[0]["time_s"])
            if kind == role and identifier in (None, one) and span_s > 0:
                total += (float(past[-1].get(name, 0)) - float(past[0].get(name, 0))) / span_s
        return total

    def waits(self) -> list[str]:
        """Who spent most of the last seconds waiting, and for what."""
        waits = []
        if self.rate("actor", "waiting_credit_s") > 0.5 * max(1, len(self.of("actor"))):
            waits.append("actors for credit")
        waits += [
            f"learner {level} for data" for level in Level if self.rate("learner", "waiting_data_s", level.value) > 0.5
        ]
        return waits

    def lag_versions(self) -> dict[Level, int]:
        """How many versions the oldest weights that act are behind their learner, by level."""
        lags = {}
        for level in Level:
            newest = self.of("learner").get(level.value, {}).get("weight_version", 0)
            acting = [
                fields[f"{level}_weight_version"]
                for fields in self.of("actor").values()
                if f"{level}_weight_version" in fields
            ]
            lags[level] = max(0, int(newest - min(acting, default=newest)))
        return lags

    def row(self) -> Fields:
        """One flat line of figures for `metrics.jsonl` and TensorBoard."""
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
        """What the shards of the replay tell of both levels, put together."""
        shards = list(self.of("replay").values())
        names = {name: None for shard in shards for name in shard if name.startswith(("high_", "low_"))}
        together: Fields = {}
        for name in names:
            values = [shard[name] for shard in shards if name in shard]
            together[name] = _TOGETHER.get(name.partition("_")[2], sum)(values)
        for level in Level:
            if f"{level}_samples_per_insert" in together:
                sampled, stored = (together.get(f"{level}_{name}", 0) for name in ("sampled", "stored"))
                together[f"{level}_samples_per_insert"] = round(sampled / max(1, stored), 3)
        return together

    def _take_json(self, parsed: keys.ParsedKey, payload: bytes) -> None:
        fields = _read(payload)
        who = (parsed.fields.get("role", ""), parsed.fields.get("id", ""))
        if fields is None:
            self.malformed += 1
        elif parsed.kind == "events":
            self.events = [*self.events[-99:], fields]
        elif parsed.kind == "stats" and _sound(fields, *who) and (who in self.roles or len(self.roles) < MAX_ROLES):
            if self.roles.get(who, {}).get("epoch") != fields.get("epoch"):
                self._history.pop(who, None)  # another process, whose counters began anew
            self.roles[who] = fields
            self._history.setdefault(who, deque(maxlen=HISTORY)).append(fields)
            self.max_lag_versions = max(self.max_lag_versions, *self.lag_versions().values())
            self.max_lag_s = max(self.max_lag_s, float(fields.get("weights_max_lag_s", 0.0)))
        else:
            self.malformed += 1


def _read(payload: bytes) -> Fields | None:
    """A flat JSON object of bounded numbers and short printable words under names; None where it is none."""
    try:
        fields = json.loads(payload) if len(payload) <= MAX_BYTES else None
    except (ValueError, RecursionError):
        return None
    if not isinstance(fields, dict):
        return None
    sound = all(keys.is_name(name) and (_number(value) or _word(value)) for name, value in fields.items())
    return fields if sound else None


def _sound(fields: Fields, role: str, identifier: str) -> bool:
    """Whether statistics are of the role they are published for, and numbers but for few words."""
    named = (fields.get("role"), fields.get("id")) == (role, identifier) and role in keys.ROLES
    return named and "time_s" in fields and all((name in WORDS) == _word(value) for name, value in fields.items())


def _word(value: object) -> bool:
    return isinstance(value, str) and len(value) <= 200 and value.isprintable()


def _number(value: object) -> bool:
    """Finite, and small enough that what is made of several is finite too."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < MAX_COUNT
