"""Progress of a run: a live table on a terminal, plain lines elsewhere. It uses only what any subscriber receives."""

import sys
import time
from types import TracebackType

from rich.live import Live
from rich.table import Table

from zsdist.common.console import PlainConsole, pairs_table
from zsdist.telemetry.snapshot import Fields, Snapshot
from zsdist.transport.base import Mailbox, Transport
from zsdist.types import Level
from zsdist.wire import keys

LINE_EVERY_S = 5.0
TABLE_EVERY_S = 0.5
QUIET_AFTER_S = 3.0  # every role reports twice a second
DONE = "done"  # last stage that a scheduler reports
MAILBOX_BYTES = 8 * 2**20


class Display:
    """Display of a run's statistics, as a context manager; the first `refresh` subscribes to them.

    Args:
        run: name of the run on the key space.
        console: the output; the default is standard output.
        prefer_lines: whether to print plain lines on a terminal too.
        started_s: unix time at which the run started; None: now.

    Attributes:
        heard_s: unix time of the last report of a role; None: there was none yet.
    """

    def __init__(
        self,
        run: str,
        console: PlainConsole | None = None,
        *,
        prefer_lines: bool = False,
        started_s: float | None = None,
    ) -> None:
        self.run = run
        self.heard_s: float | None = None
        self.snapshot = Snapshot()
        self.console = console or PlainConsole(file=sys.stdout)
        self._mailbox: Mailbox | None = None
        self._announced_s = 0.0  # time of the last event that was printed
        self._opened_s = self._heard_s = time.monotonic()
        self._earlier_s = 0.0 if started_s is None else max(0.0, time.time() - started_s)
        self._next_s = self._opened_s
        self._shown_s = 0.0
        self._live = (
            Live(console=self.console, auto_refresh=False) if self.console.is_terminal and not prefer_lines else None
        )

    def __enter__(self) -> "Display":
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.__exit__(kind, error, trace)

    def refresh(self, transport: Transport, now: float) -> None:
        """Receive what has arrived, and show it when that is due."""
        self.update(transport)
        self._announce()
        if time.monotonic() < self._next_s:
            return
        if self._live is not None:
            self._next_s = time.monotonic() + TABLE_EVERY_S
            self._live.update(self.table(), refresh=True)
        elif self.snapshot.roles:
            self._next_s = time.monotonic() + LINE_EVERY_S
            self.console.say(self.line())

    def update(self, transport: Transport) -> None:
        """Receive statistics, events and liveliness; the first call subscribes to them."""
        if self._mailbox is None:
            self._mailbox = Mailbox(MAILBOX_BYTES)
            transport.subscribe(keys.stats(self.run, keys.ANY, keys.ANY), self._mailbox)
            transport.subscribe(keys.events(self.run), self._mailbox)
            transport.watch_alive(keys.alive(self.run, keys.ANY, keys.ANY), self._mailbox)
        before = self.snapshot.reports
        self.snapshot.update(self._mailbox.drain())
        if self.snapshot.reports > before:
            self.heard_s, self._heard_s = time.time(), time.monotonic()

    @property
    def silent_s(self) -> float:
        """Seconds since the last report of a role, or since the display was made."""
        return time.monotonic() - self._heard_s

    @property
    def is_quiet(self) -> bool:
        """True if reports are overdue, so that the last figures are old."""
        return self.silent_s > QUIET_AFTER_S

    @property
    def done(self) -> bool:
        """True if the scheduler has reported the end of the run."""
        return any(fields.get("stage") == DONE for fields in self.snapshot.of("scheduler").values())

    def _announce(self) -> None:
        """Print new events that nobody may miss."""
        told_s = self._announced_s  # several events may have one time
        for event in self.snapshot.events:
            time_s = event.get("time_s", 0.0)
            if isinstance(time_s, str) or time_s <= told_s or not (line := _news(event)):
                continue
            self._announced_s = max(self._announced_s, float(time_s))
            self.console.say(line)

    def figures(self) -> dict[str, str]:
        """Return the text under each heading."""
        snapshot, row = self.snapshot, self.snapshot.row()

        def number(name: str, digits: int = 2) -> str:
            value = row.get(name)
            return "-" if value is None else f"{float(value):.{digits}f}"

        counts = " ".join(f"{row.get(name, 0)}" for name in ("success", "collision", "timeout"))
        levels = [level.value for level in Level]
        still = self.done or self.is_quiet  # then rates are those of the past
        left = f", {row['drives_left']:.0f} drives left" if row.get("drives_left") else ""
        if row.get("states_awaited"):
            left = f", saving: {row['states_awaited']} not there yet"
        return {
            "episodes": f"{row.get('episodes', 0)}/{row.get('episodes_target', '?')}",
            "stage": f"{row.get('stage', 'starting')}{left}",
            "success, last 50": number("recent_success"),
            "success collision timeout": counts,
            "return": number("mean_return", 1),
            "epsilon": number("epsilon"),
            "env steps": f"{row.get('env_steps', 0):.0f}" + ("" if still else f" ({row['env_steps_per_s']:.0f}/s)"),
            **{f"loss {level}": number(f"{level}_loss", 4) for level in levels},
            "updates": " ".join(f"{level} {row.get(f'{level}_learner_updates', 0)}" for level in levels),
            "updates/s": "-"
            if still
            else " ".join(f"{level} {row.get(f'{level}_updates_per_s', 0):.0f}" for level in levels),
            "replay": " ".join(f"{level} {row.get(f'replay_{level}_size', 0)}" for level in levels),
            "batch": f"{row.get('replay_low_batch_size', '-')}",
            "weight lag": " ".join(f"{level} {lag}" for level, lag in snapshot.lag_versions().items()),
            "merges": f"{row.get('merges', 0)}",
            "restarts": f"{row.get('restarts', 0)}",
            "roles alive": "-" if still else f"{len(snapshot.alive)}",
            "waiting": self._waiting(),
        }

    def line(self) -> str:
        """Return the progress as one plain line."""
        shown = "  ".join(f"{name} {value}" for name, value in self.figures().items())
        return f"[{self._time_s():6.1f} s] {shown}"

    def table(self) -> Table:
        """Return the progress as a table for terminals."""
        rows = [("run", self.run), ("time", f"{self._time_s():.0f} s"), *self.figures().items()]
        for event in self.snapshot.events[-3:]:
            shown = {name: value for name, value in event.items() if name not in ("time_s", "host", "pid", "id")}
            rows.append(("event", " ".join(f"{name}={value}" for name, value in shown.items())))
        return pairs_table(rows)

    def _waiting(self) -> str:
        if self.done:
            return "nothing: the run has ended"
        if self.is_quiet:
            return f"for a word of the run, the last came {self.silent_s:.0f} s ago"
        return "; ".join(self.snapshot.waits()) or "nothing"

    def _time_s(self) -> float:
        """Return the age of the run at its last report."""
        still = self.done or self.is_quiet
        age_s = self._earlier_s + (self._heard_s if still else time.monotonic()) - self._opened_s
        self._shown_s = max(self._shown_s, age_s)
        return self._shown_s


def _news(event: Fields) -> str:
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
