"""Standard output and errors that may vanish while a command works: a closed pipe, a lost terminal, a full disk."""

import contextlib
import errno
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Any, TextIO

from zsdist.common import signals
from zsdist.common.plain_lines import say
from zsdist.errors import RunError


class GuardedStream:
    """Text stream that drops what it cannot write, so that the work goes on.

    A pipe that its reader has closed counts as the signal SIGPIPE, which asks the command to stop.

    Args:
        stream: stream to write to.
        name: name of the stream in errors.

    Attributes:
        lost: first error of the stream; None while it works.
    """

    def __init__(self, stream: TextIO, name: str) -> None:
        self.lost: OSError | None = None
        self._stream, self._name = stream, name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text, or drop it where the stream is lost."""
        self._attempt(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush the stream, where it is not lost."""
        self._attempt(self._stream.flush)

    def check(self) -> None:
        """Raise `RunError` where something was dropped for another reason than a closed pipe."""
        if self.lost is not None and self.lost.errno != errno.EPIPE:
            raise RunError(f"{self._name} cannot be written: {self.lost.strerror or self.lost}")

    def _attempt(self, act: Callable[[], object]) -> None:
        if self.lost is not None:
            return
        try:
            act()
        except OSError as error:
            self.lost = error
            with contextlib.suppress(OSError):  # a stream without a file descriptor
                self._discard(self._stream.fileno())
            if error.errno == errno.EPIPE:
                signals.request(signal.SIGPIPE)

    def _discard(self, descriptor: int) -> None:
        """Send the rest of the output, also that of libraries, to nowhere."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, descriptor)
        os.close(nowhere)


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """Guard standard output and errors, and open those that are closed, so that no file takes their place."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
    before = sys.stdout, sys.stderr
    names = ("standard output", "standard error")
    guards = [stream and GuardedStream(stream, name) for stream, name in zip(before, names, strict=True)]
    sys.stdout, sys.stderr = guards
    try:
        yield
    finally:
        for guard in guards:
            if guard is not None:
                with contextlib.suppress(KeyboardInterrupt):  # the command has ended already
                    guard.flush()
        sys.stdout, sys.stderr = before


def check_output() -> None:
    """Write out what standard output holds back; raise `RunError` where some of it was lost on a full disk."""
    if isinstance(sys.stdout, GuardedStream):
        sys.stdout.flush()
        sys.stdout.check()


def tell(*lines: str) -> None:
    """Print last lines for the user: on standard output, or on standard error where nobody reads the former."""
    lost = isinstance(sys.stdout, GuardedStream) and sys.stdout.lost is not None
    for line in lines:
        say(line, error=lost)
