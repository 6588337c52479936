"""View of a run for people at a terminal: plain data, made of a snapshot; `screen` draws it."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from zsdist.common.plain_lines import plain
from zsdist.telemetry.curves import CurveHistory
from zsdist.telemetry.snapshot import Fields, Snapshot
from zsdist.types import Level

Role = tuple[str, str]  # kind and id
LINE_LENGTH = 120  # characters of a plain line, at most
QUIET_AFTER_S = 3.0  # every role reports twice a second
DONE = "done"  # last stage that a scheduler reports
STARTING = "starting"
_NAMED = 4  # roles that are named where some are missing
_MUTE = ("time_s", "host", "pid", "id", "role", "epoch", "event")  # fields of an event that say nothing to a reader


@dataclass(frozen=True)
class Clock:
    """Times of a watched run, s.

    Attributes:
        age_s: time since the run's start, or since it is watched, at its last report.
        silent_s: time since the last report of any role.
        known: whether `age_s` counts from the run's start.
    """

    age_s: float
    silent_s: float = 0.0
    known: bool = True

    @property
    def is_quiet(self) -> bool:
        """True if reports are overdue, so that the last figures are old."""
        return self.silent_s > QUIET_AFTER_S


@dataclass(frozen=True)
class RoleLine:
    """One role as it is shown.

    Attributes:
        name: name such as `actor-0`.
        health: `ok`, `starting`, `gone`, or `silent 12 s`.
        telling: its most telling figures.
    """

    name: str
    health: str
    telling: str

    @property
    def well(self) -> bool:
        """True if nothing is wrong with it."""
        return self.health in ("ok", STARTING)


@dataclass(frozen=True)
class RunView:
    """A run as it is shown.

    Attributes:
        run: name of the run.
        clock: its times.
        stage: stage of the run, one word.
        doing: what else is under way; empty where nothing is.
        episodes: finished training episodes.
        target: training episodes of the whole run; None: not known yet.
        left_s: estimated time to the last training episode; None: no estimate.
        waiting: who waits for what.
        figures: text under each heading.
        roles: all roles, those in trouble first.
        events: last events, one line each, the newest last.
        history: figures over episodes.
    """

    run: str
    clock: Clock
    stage: str
    doing: str
    episodes: int
    target: int | None
    left_s: float | None
    waiting: str
    figures: Mapping[str, str]
    roles: tuple[RoleLine, ...]
    events: tuple[str, ...]
    history: CurveHistory = field(repr=False)

    @property
    def state(self) -> str:
        """Stage, with what else is under way."""
        return f"{self.stage}, {self.doing}" if self.doing else self.stage

    def line(self) -> str:
        """Return the progress as one plain line of at most `LINE_LENGTH` characters.

        Where figures are so long that not all fit, the least important are left out.
        """
        target = "?" if self.target is None else self.target
        since = f"{self.clock.age_s:6.1f} s" + ("" if self.clock.known else " watched")
        line, waiting = f"[{since}] {self.stage}  episodes {self.episodes}/{target}", f"waiting {self.waiting}"
        figures = ("success", "env steps/s", "roles alive", "return", "restarts")
        for part in (*(f"{name} {self.figures[name]}" for name in figures), self.doing):
            if part and len(line) + len(part) + len(waiting) + 4 <= LINE_LENGTH:
                line += f"  {part}"
        return fitted(f"{line}  {waiting}", LINE_LENGTH)


def view_of(
    run: str,
    snapshot: Snapshot,
    clock: Clock,
    *,
    history: CurveHistory | None = None,
    expected: Collection[str] = (),
    silent_s: Mapping[Role, float] | None = None,
    notices: Collection[str] = (),
) -> RunView:
    """Return what is shown of a snapshot.

    Args:
        run: name of the run.
        snapshot: latest statistics.
        clock: times of the run.
        history: figures since the beginning.
        expected: names of the roles that the run has once it has started, where they are known.
        silent_s: time since the last report of each role.
        notices: lines that were said meanwhile; they stand behind the events.
    """
    row, history = snapshot.row(), history or CurveHistory()
    reported = {"-".join(role) for role in snapshot.roles}
    gone = {event.get("actor") for event in snapshot.events if event.get("event") == "actor_left"}
    missing = [name for name in expected if name not in reported and name not in gone]
    begun = not missing or int(row.get("env_steps", 0)) > 0 or int(row.get("actors_env_steps", 0)) > 0
    stage = str(row.get("stage", STARTING)) if begun or row.get("stage") not in (None, "train") else STARTING
    done = row.get("stage") == DONE
    episodes, target = int(row.get("episodes", 0)), row.get("episodes_target")
    training = row.get("stage") == "train" and not clock.is_quiet
    return RunView(
        run=run,
        clock=clock,
        stage=stage,
        doing=_doing(row),
        episodes=episodes,
        target=None if target is None else int(float(target)),
        left_s=history.left_s(float(target)) if target is not None and training else None,
        waiting=_waiting(snapshot, clock, stage, missing, len(expected), done=done),
        figures=_figures(snapshot, row, still=done or clock.is_quiet),
        roles=_roles(snapshot, missing, silent_s or {}, done=done),
        events=(*(_event(event) for event in snapshot.events[-20:]), *notices),
        history=history,
    )


def fitted(text: str, length: int) -> str:
    """Return a text of at most `length` characters, cut with an ellipsis where it is longer."""
    return text if len(text) <= length else text[: length - 1] + "…"


def duration(seconds: float) -> str:
    """Return a duration as `12 s`, `3 min 05 s` or `5 h 07 min`."""
    whole = int(seconds)
    if whole < 60:
        return f"{whole} s"
    return f"{whole // 60} min {whole % 60:02d} s" if whole < 3600 else f"{whole // 3600} h {whole // 60 % 60:02d} min"


def _doing(row: Fields) -> str:
    if row.get("states_awaited"):
        names = str(row["states_awaited"]).split()
        return f"saving: {_some(names)} not there yet"
    return f"merge: {row['drives_left']:.0f} drives left" if row.get("drives_left") else ""


def _waiting(snapshot: Snapshot, clock: Clock, stage: str, missing: list[str], expected: int, *, done: bool) -> str:
    if done:
        return "nothing: the run has ended"
    if not snapshot.roles:
        return f"for the first of {expected} roles" if expected else "for the first word of the run"
    if clock.is_quiet:
        return f"for a word of the run, the last came {clock.silent_s:.0f} s ago"
    if stage == STARTING and missing:
        return f"for {_some(missing)} ({expected - len(missing)} of {expected} roles are there)"
    waits = "; ".join(snapshot.waits())
    return waits.replace("learner high for data; learner low for data", "learners for data") or "nothing"


def _some(names: list[str]) -> str:
    """Return the first of some names, and the number of the others."""
    more = len(names) - _NAMED
    return " ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _figures(snapshot: Snapshot, row: Fields, *, still: bool) -> dict[str, str]:
    """Return the text under each heading, the most telling first; of a run that stands still no rates."""

    def number(name: str, digits: int = 2) -> str:
        value = row.get(name)
        return "-" if value is None else f"{float(value):.{digits}f}"

    levels = [level.value for level in Level]
    return {
        "success": number("recent_success"),
        "success collision timeout": " ".join(f"{row.get(name, 0)}" for name in ("success", "collision", "timeout")),
        "return": number("mean_return", 1),
        "env steps": f"{row.get('env_steps', 0):.0f}",
        "env steps/s": "-" if still else f"{row['env_steps_per_s']:.0f}",
        "updates/s": "-" if still else " ".join(f"{name} {row.get(f'{name}_updates_per_s', 0):.0f}" for name in levels),
        "loss": " ".join(f"{name} {number(f'{name}_loss', 4)}" for name in levels),
        "replay": " ".join(f"{name} {row.get(f'replay_{name}_size', 0)}" for name in levels),
        "weight lag": " ".join(f"{level} {lag}" for level, lag in snapshot.lag_versions().items()),
        "merges": f"{row.get('merges', 0)}",
        "restarts": f"{row.get('restarts', 0)}",
        "roles alive": "-" if still else f"{len(snapshot.alive)}",
        "epsilon": number("epsilon"),
        "batch": f"{row.get('replay_low_batch_size', '-')}",
        "updates": " ".join(f"{name} {row.get(f'{name}_learner_updates', 0)}" for name in levels),
    }


def _roles(
    snapshot: Snapshot, missing: list[str], silent_s: Mapping[Role, float], *, done: bool
) -> tuple[RoleLine, ...]:
    lines = []
    for role, fields in snapshot.roles.items():
        silence_s = silent_s.get(role, 0.0)
        health = "ok"
        if not done and silence_s > QUIET_AFTER_S:
            health = f"silent {silence_s:.0f} s" if role in snapshot.alive else "gone"
        lines.append(RoleLine("-".join(role), health, "" if done else _telling(snapshot, role, fields)))
    known = {line.name for line in lines}
    begins = {*missing, *("-".join(role) for role in snapshot.alive)} - known
    lines += [RoleLine(name, STARTING, "") for name in begins]
    return tuple(sorted(lines, key=lambda line: (line.well, *_order(line.name))))


def _order(name: str) -> tuple[int, int, str]:
    kind, _, identifier = name.partition("-")
    kinds = ("scheduler", "learner", "replay", "hub", "actor")
    number = int(identifier) if identifier.isascii() and identifier.isdecimal() else 0
    return kinds.index(kind) if kind in kinds else len(kinds), number, identifier


def _telling(snapshot: Snapshot, role: Role, fields: Fields) -> str:
    kind, identifier = role

    def figure(name: str) -> float:
        value = fields.get(name, 0)
        return 0.0 if isinstance(value, str) else float(value)

    match kind:
        case "actor":
            waits = f", {figure('cars_waiting_credit'):.0f} wait" if figure("cars_waiting_credit") else ""
            cars = f"{figure('cars_driving'):.0f}/{figure('cars'):.0f} cars"
            return f"{snapshot.rate(kind, 'env_steps', identifier):.0f} steps/s, {cars}{waits}"
        case "learner":
            rate = snapshot.rate(kind, "learner_updates", identifier)
            return f"{rate:.0f} updates/s, v{figure('weight_version'):.0f}"
        case "replay":
            return f"high {figure('high_size'):.0f}, low {figure('low_size'):.0f}"
        case "scheduler":
            return f"{figure('episodes_in_flight'):.0f} episodes under way"
        case "hub":
            return str(fields.get("endpoint", ""))
    return ""


def _event(event: Fields) -> str:
    shown = {name: value for name, value in event.items() if name not in _MUTE}
    return plain(
        news(event) or f"{event.get('event')}: " + " ".join(f"{name}={value}" for name, value in shown.items())
    )


def news(event: Fields) -> str:
    """Return the line about an event that nobody may miss; empty for any other one."""
    match event.get("event"):
        case "standstill":
            since_s, waits, in_flight = (event.get(name) for name in ("since_s", "waits", "in_flight"))
            return f"nothing has moved for {since_s} s: waiting are {waits}; {in_flight} messages are in flight"
        case "journal_damaged":
            return f"{event.get('role')}-{event.get('id')}: {event.get('what')}"
        case "role_replaced":
            return f"{event.get('name')} is replaced: {event.get('reason')}"
        case "role_waits":
            return f"{event.get('name')} waits: {event.get('reason')}"
        case "actor_joined":
            return f"{event.get('actor')} has joined the run"
        case "actor_left":
            return f"{event.get('actor')} has left the run"
    return ""
