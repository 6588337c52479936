"""Progress of long work on the standard error stream: a bar on a terminal, else a plain line every few seconds."""

import sys
import time
from types import TracebackType
from typing import Self

from zsdist.common.console import PlainConsole, bars, say

PLAIN_EVERY_S = 5.0


class StepProgress:
    """Progress of work whose number of steps is known; the work is done inside a `with` block.

    Args:
        title: words before the counts.
        total: number of steps.
        done: number of steps that were done before.
    """

    def __init__(self, title: str, total: int, done: int = 0) -> None:
        self._title, self._total, self._done = title, total, done
        self._printed_s = time.monotonic()
        self._bar = bars(PlainConsole(stderr=True), transient=True) if sys.stderr.isatty() else None
        if self._bar:
            self._task = self._bar.add_task(title, total=total, completed=done)

    def __enter__(self) -> Self:
        if self._bar:
            self._bar.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar:
            self._bar.__exit__(kind, error, trace)

    def step(self, words: str = "") -> None:
        """Count one more step; `words` stand behind the counts."""
        self._done += 1
        behind = f": {words}" if words else ""
        if self._bar:
            self._bar.update(self._task, advance=1, description=f"{self._title}{behind}")
        elif time.monotonic() - self._printed_s > PLAIN_EVERY_S:
            self._printed_s = time.monotonic()
            say(f"{self._title}: {self._done} of {self._total}{behind}", error=True)
