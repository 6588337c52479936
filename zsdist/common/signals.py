"""Signals that ask a command to stop, as terminals, batch systems, containers and service managers send them."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

STOPPING = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGQUIT,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGXCPU,
    signal.SIGPWR,
    signal.SIGRTMIN + 3,
)
IGNORED_BY_SHELLS = (signal.SIGINT, signal.SIGQUIT)  # by every shell, for the background commands of a script
ONE_REQUEST_S = 0.5  # `timeout`, terminals and service managers send a signal twice, or two signals, at once


class Interrupted(KeyboardInterrupt):
    """Interruption by a signal.

    Attributes:
        number: number of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


class Interruption:
    """Handler of the signals `STOPPING`.

    The first one raises `Interrupted`, or only sets the flag that a call returns. A second one raises it in any case.
    A third one has its default effect: it kills the process. Signals within `ONE_REQUEST_S` of one another count as
    one.

    Args:
        at_once: whether the first signal raises.
        clock: function that returns the time in seconds.

    Attributes:
        number: number of the first signal; None before it.
    """

    def __init__(self, *, at_once: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self.number: int | None = None
        self._at_once = at_once
        self._clock = clock
        self._counted_s = 0.0
        self._insisted = False

    def __call__(self) -> bool:
        """Return whether to stop."""
        return self.number is not None

    @property
    def name(self) -> str:
        """Name of the signal, such as `SIGTERM`."""
        return name_of(self.number)

    @property
    def status(self) -> int:
        """Exit status of a command that the signal has stopped."""
        return 128 + (self.number or signal.SIGINT)

    def on_signal(self, number: int, frame: FrameType | None) -> None:
        """Count a signal; raise `Interrupted` where it asks to stop at once."""
        now = self._clock()
        if self.number is not None and (number == signal.SIGPIPE or now - self._counted_s < ONE_REQUEST_S):
            return
        self._counted_s = now
        first, self.number = self.number is None, number if self.number is None else self.number
        if first and not self._at_once:
            return
        if self._insisted or (self._at_once and not first):
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        self._insisted = True
        raise Interrupted(self.number)


@contextmanager
def handled_by(interruption: Interruption) -> Iterator[Interruption]:
    """Handle the signals by `interruption`, and restore the handlers that were there before.

    A signal that is ignored stays ignored, as `nohup` wants it; but not one of `IGNORED_BY_SHELLS`. In another thread
    than the main one, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return
    before = {}
    for number in STOPPING:
        if number in IGNORED_BY_SHELLS or signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, interruption.on_signal)
    try:
        yield interruption
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def withheld() -> Iterator[None]:
    """Block the signals meanwhile; at the end, what has arrived takes effect. Handlers are kept as by `kept`.

    Processes that are started meanwhile inherit the block for good: a signal to the whole process group, or to all
    processes of a job, leaves them alone. Their parent has to end them, by SIGKILL. In another thread than the main
    one, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
    try:
        with kept():
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextmanager
def kept() -> Iterator[None]:
    """Restore the signals' handlers at the end, whichever a library has set meanwhile, also below Python."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in STOPPING}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            if handler is not None:  # None: a library had set it below Python
                signal.signal(number, handler)


def request(number: int) -> None:
    """Ask this process to stop as if a signal had arrived; nothing happens where none is handled."""
    handler = signal.getsignal(signal.SIGINT)  # the handler of all
    if isinstance(getattr(handler, "__self__", None), Interruption) and callable(handler):
        handler(number, None)


def status_of(error: KeyboardInterrupt) -> int:
    """Return the exit status of a command that a signal has stopped, as shells give it: 128 plus its number."""
    return 128 + number_of(error)


def number_of(error: KeyboardInterrupt) -> int:
    """Return the number of the signal that has raised an interruption."""
    return error.number if isinstance(error, Interrupted) else signal.SIGINT


def name_of(number: int | None) -> str:
    """Return the name of a signal; an unknown one is a Ctrl-C."""
    number = number or signal.SIGINT
    if signal.SIGRTMIN < number < signal.SIGRTMAX:
        return f"SIGRTMIN+{number - signal.SIGRTMIN}"
    return signal.Signals(number).name
