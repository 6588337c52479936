"""Progress of a run: a full screen on a terminal, plain lines elsewhere. It uses only what any subscriber receives."""

import contextlib
import io
import sys
import textwrap
import time
from collections.abc import Callable, Collection
from types import TracebackType
from typing import IO, Any

from rich.live import Live
from rich.table import Table

from zsdist.common.console import PlainConsole, pairs_table
from zsdist.common.plain_lines import plain
from zsdist.telemetry.curves import CurveHistory
from zsdist.telemetry.screen import RunScreen
from zsdist.telemetry.snapshot import Fields, Snapshot
from zsdist.telemetry.view import DONE as DONE
from zsdist.telemetry.view import LINE_LENGTH, QUIET_AFTER_S, Clock, Role, RunView, news, view_of
from zsdist.transport.base import Mailbox, Transport
from zsdist.wire import keys

LINE_EVERY_S = 5.0
SCREEN_EVERY_S = 1.0
NOTICES = 50  # lines said meanwhile that are kept
MAILBOX_BYTES = 8 * 2**20


class Display:
    """Display of a run's statistics, as a context manager; the first `refresh` subscribes to them.

    On a terminal it fills the screen, and leaves it as it was. What is printed meanwhile is shown among the events, and
    stands on the terminal afterwards.

    Args:
        run: name of the run on the key space.
        title: name of the run for people, as its folder has it; None: the same.
        console: the output; the default is standard output.
        prefer_lines: whether to print plain lines on a terminal too.
        started_s: unix time at which the run started; None: it is not known, and the time since now is shown.
        expected: names of the roles that the run has once it has started, where they are known.
        history: figures of the run so far.

    Attributes:
        heard_s: unix time of the last report of a role; None: there was none yet.
    """

    def __init__(
        self,
        run: str,
        console: PlainConsole | None = None,
        *,
        title: str | None = None,
        prefer_lines: bool = False,
        started_s: float | None = None,
        expected: Collection[str] = (),
        history: CurveHistory | None = None,
    ) -> None:
        self.run = run
        self.title = run if title is None else title
        self.heard_s: float | None = None
        self.snapshot = Snapshot()
        self.console = console or PlainConsole(file=sys.stdout)
        self._expected, self._history = expected, history or CurveHistory()
        self._mailbox: Mailbox | None = None
        self._announced_s = 0.0  # time of the last event that was printed
        self._opened_s = self._heard_s = self._refreshed_s = time.monotonic()
        self._started_is_known = started_s is not None
        self._earlier_s = 0.0 if started_s is None else max(0.0, time.time() - started_s)
        self._next_s = self._opened_s
        self._shown_s = 0.0
        self._reports: dict[Role, tuple[Fields, float]] = {}  # last report of each role, and since when it is known
        self._was_shown = False
        self._said: list[str] = []  # lines said while the screen was full, which it shows
        self._afterwards: list[str] = []  # lines that the terminal keeps
        self._full_screen = not prefer_lines and _can_fill_screen(self.console)
        self._live: Live | None = None
        self._closing = contextlib.ExitStack()

    def __enter__(self) -> "Display":
        if self._full_screen:
            screen = PlainConsole(file=self.console.file, force_terminal=True)
            said: Any = _SaidLines(self.tell, self.console.file)
            self._closing.enter_context(contextlib.redirect_stdout(said))
            self._closing.enter_context(contextlib.redirect_stderr(said))
            live = Live(console=screen, screen=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
            self._live = self._closing.enter_context(live)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live = None
        self._closing.close()
        if self._full_screen:
            for line in self._afterwards:
                self._say(line)
        if self._was_shown and self.snapshot.roles:
            self._say(self.line())  # the last state stays

    def refresh(self, transport: Transport, now: float) -> None:
        """Receive what has arrived, and show it when that is due.

        Where it is called late, as by a run that computes in the same process, nobody counts as silent meanwhile.
        """
        late_s, self._refreshed_s = time.monotonic() - self._refreshed_s, time.monotonic()
        if late_s > QUIET_AFTER_S:
            self._heard_s += late_s
            self._reports = {role: (fields, since_s + late_s) for role, (fields, since_s) in self._reports.items()}
        self.update(transport)
        self._announce()
        self.show()

    def show(self) -> None:
        """Show the present state when that is due."""
        if time.monotonic() < self._next_s:
            return
        self._was_shown = True
        if self._live is not None:
            self._next_s = time.monotonic() + SCREEN_EVERY_S
            self._live.update(RunScreen(self.view()), refresh=True)
        else:
            self._next_s = time.monotonic() + LINE_EVERY_S
            self._say(self.line())

    def tell(self, line: str) -> None:
        """Say a line: at once, or where the screen is full among the events, and afterwards."""
        if self._live is None:
            self._say(line)
            return
        self._said = [*self._said[1 - NOTICES :], plain(line)]
        self._keep(line)
        self._next_s = self._opened_s

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
            if self.heard_s is None:
                self._next_s = self._opened_s  # the first word is shown at once
            self.heard_s, self._heard_s = time.time(), time.monotonic()

    @property
    def silent_s(self) -> float:
        """Seconds since the last report of a role, or since the display was made."""
        return time.monotonic() - self._heard_s

    @property
    def is_quiet(self) -> bool:
        """True if reports are overdue, so that the last figures are old."""
        return self._clock().is_quiet

    @property
    def done(self) -> bool:
        """True if the scheduler has reported the end of the run."""
        return any(fields.get("stage") == DONE for fields in self.snapshot.of("scheduler").values())

    def view(self) -> RunView:
        """Return what is shown now."""
        now = time.monotonic()
        for role, fields in self.snapshot.roles.items():
            if role not in self._reports or self._reports[role][0] is not fields:
                self._reports[role] = fields, now
        self._history.add(self.snapshot.row() | {"time_s": time.time()})  # the run's own clock may be a virtual one
        return view_of(
            self.title,
            self.snapshot,
            self._clock(),
            history=self._history,
            expected=self._expected,
            silent_s={role: now - since_s for role, (_, since_s) in self._reports.items()},
            notices=self._said,
        )

    def line(self) -> str:
        """Return the progress as one plain line."""
        return self.view().line()

    def table(self) -> Table:
        """Return the progress as a table, for one snapshot."""
        view = self.view()
        target = "?" if view.target is None else view.target
        rows = [
            ("run", self.title),
            ("time", f"{view.clock.age_s:.0f} s" + ("" if view.clock.known else " watched")),
            ("episodes", f"{view.episodes}/{target}"),
            ("stage", view.state),
            *view.figures.items(),
            ("waiting", view.waiting),
        ]
        return pairs_table([*rows, *(("event", event) for event in view.events[-3:])])

    def _say(self, line: str) -> None:
        for part in textwrap.wrap(plain(line), LINE_LENGTH, subsequent_indent="  ", break_on_hyphens=False):
            self.console.say(part)

    def _announce(self) -> None:
        """Print new events that nobody may miss."""
        told_s = self._announced_s  # several events may have one time
        for event in self.snapshot.events:
            time_s = event.get("time_s", 0.0)
            if isinstance(time_s, str) or time_s <= told_s or not (line := news(event)):
                continue
            self._announced_s = max(self._announced_s, float(time_s))
            if self._live is None:
                self._say(line)
            else:
                self._keep(line)  # the screen shows all events

    def _keep(self, line: str) -> None:
        self._afterwards = [*self._afterwards[1 - NOTICES :], line]

    def _clock(self) -> Clock:
        """Return the age of the run at its last report, and the silence since then."""
        silent_s = self.silent_s
        still = self.done or Clock(0.0, silent_s).is_quiet
        stands = still and self.heard_s is not None  # before the first word the time of the start is shown
        age_s = self._earlier_s + (self._heard_s if stands else time.monotonic()) - self._opened_s
        self._shown_s = max(self._shown_s, age_s)
        return Clock(self._shown_s, silent_s, self._started_is_known)


class _SaidLines(io.TextIOBase):
    """Stream in the place of standard output while the screen is full: whole lines go to `tell`.

    Args:
        tell: called with each line.
        file: stream that it stands for.
    """

    def __init__(self, tell: Callable[[str], None], file: IO[str]) -> None:
        super().__init__()
        self._tell, self._file, self._rest = tell, file, ""

    def fileno(self) -> int:
        """Return the number of the open file that it stands for, for what writes past Python."""
        return self._file.fileno()

    @property
    def encoding(self) -> str:  # type: ignore[override]  # typeshed has an attribute
        """Encoding of what is written."""
        return "utf-8"

    def writable(self) -> bool:
        """Return True."""
        return True

    def write(self, text: str) -> int:
        """Take a text; each line that is complete is told."""
        *told, self._rest = (self._rest + text).split("\n")
        for line in told:
            self._tell(line)
        return len(text)


def _can_fill_screen(console: PlainConsole) -> bool:
    """Return whether the output is a terminal that can place the cursor and show the signs of a screen."""
    return console.is_terminal and not console.is_dumb_terminal and console.encoding.startswith("utf")
