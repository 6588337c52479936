"""Progress of a pretraining: bars on a terminal with a line per epoch above them, plain lines elsewhere."""

import sys
import time
from types import TracebackType
from typing import Self

from rich.progress import Progress, TaskID

from zsdist.common.console import PlainConsole, bars

LINE_EVERY_S = 10.0


class PretrainingProgress:
    """Display of the progress of a pretraining, as a context manager.

    Args:
        console: console to print on; None: standard output.
        prefer_lines: whether to print plain lines even on a terminal.
    """

    def __init__(self, console: PlainConsole | None = None, *, prefer_lines: bool = False) -> None:
        self.console = console or PlainConsole(file=sys.stdout)
        self._start_s = time.monotonic()
        self._next_s = 0.0
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        if self.console.is_terminal and not prefer_lines:
            self._bars = bars(self.console, remaining=True)

    def __enter__(self) -> Self:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._bars is not None:
            self._bars.stop()

    def log(self, text: str) -> None:
        """Print a line with the time since the start."""
        seconds = time.monotonic() - self._start_s
        self.console.say(f"[{seconds:6.0f} s] {text}")

    def pictures(self, made: int, planned: int) -> None:
        """Show the number of pictures made; plain lines are printed at most every `LINE_EVERY_S`."""
        self._bar("pictures", made, planned)
        if self._bars is None and (made == planned or time.monotonic() >= self._next_s):
            self._next_s = time.monotonic() + LINE_EVERY_S
            self.log(f"pictures: {made} of {planned} rendered and encoded")

    def epoch(self, stage: str, figures: dict[str, float], epochs: int) -> None:
        """Show the figures of an epoch of a stage."""
        self._bar(stage, int(figures["epoch"]), epochs)
        parts = [
            f"{name.removeprefix('validation_')} {value:.3f}"
            for name, value in figures.items()
            if name.startswith("validation_") and name != "validation_loss"
        ]
        self.log(
            f"{stage}: epoch {figures['epoch']:.0f} of {epochs}, loss {figures['loss']:.3f}, "
            f"validation {figures['validation_loss']:.3f} ({', '.join(parts)})"
        )

    def _bar(self, name: str, done: int, total: int) -> None:
        """Move the bar of a stage, or do nothing without bars."""
        if self._bars is None:
            return
        if name not in self._tasks:
            self._tasks[name] = self._bars.add_task(name, total=total)
        self._bars.update(self._tasks[name], completed=done, total=total)
