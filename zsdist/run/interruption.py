"""Request to stop a run early, made by Ctrl-C or SIGTERM."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interruption:
    """Flag that the first signal sets; a second signal raises `KeyboardInterrupt`, which stops without saving."""

    def __init__(self) -> None:
        self._requested = False

    def __call__(self) -> bool:
        """Return whether to stop."""
        return self._requested

    def on_signal(self, signal_number: int, frame: FrameType | None) -> None:
        """Set the flag at the first signal; raise `KeyboardInterrupt` at the second."""
        if self._requested:
            raise KeyboardInterrupt
        self._requested = True


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Handle SIGINT and SIGTERM by an `Interruption`; restore the handlers that were there before."""
    interruption = Interruption()
    before = {number: signal.signal(number, interruption.on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield interruption
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
