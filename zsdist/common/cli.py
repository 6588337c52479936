"""What all commands share: one-line errors, exit statuses, Ctrl-C and what means the same, whole numbers."""

import argparse
import errno
import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import NoReturn

from zsdist.errors import ZsdistError

REFUSED = 2
INTERRUPTED = 130


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line, without the usage of every option before it."""

    def error(self, message: str) -> NoReturn:
        """Print the complaint and leave with status 2."""
        self.exit(REFUSED, f"{self.prog}: error: {message} (--help lists what is allowed)\n")


def execute(
    main: Callable[[argparse.Namespace], int],
    parser: argparse.ArgumentParser,
    arguments: Sequence[str] | None = None,
) -> NoReturn:
    """Run a command and leave with its status; a `--debug` option is added to the parser.

    A `ZsdistError` is one line on the standard error stream and status 2 (`--debug`: the traceback, status 1); Ctrl-C
    is status 130, and so is SIGTERM, by which a service manager asks for the same. A name of a file too long for the
    system is one line too. Any other exception is a defect and keeps its traceback.

    Args:
        main: the command; returns its exit status.
        parser: of the command's own options.
        arguments: instead of those of the process.
    """
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    options = parser.parse_args(arguments)
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        status = main(options)
    except ZsdistError as error:
        if options.debug:
            raise
        print(f"{parser.prog}: error: {' '.join(str(error).split())}", file=sys.stderr)
        status = REFUSED
    except OSError as error:
        if options.debug or error.errno != errno.ENAMETOOLONG:  # such a name can only have been given by a person
            raise
        print(f"{parser.prog}: error: {error.filename}: {error.strerror}", file=sys.stderr)
        status = REFUSED
    except KeyboardInterrupt:
        print(f"{parser.prog}: interrupted", file=sys.stderr)
        status = INTERRUPTED
    finally:
        signal.signal(signal.SIGTERM, before)
    sys.exit(status)


def count(text: str) -> int:
    """The type of an option that is a whole number of 1 or more."""
    return _whole(text, 1)


def natural(text: str) -> int:
    """The type of an option that is a whole number of 0 or more."""
    return _whole(text, 0)


def _whole(text: str, least: int) -> int:
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is a whole number of {least} or more")
    return int(text)


def _interrupt(signal_number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt
