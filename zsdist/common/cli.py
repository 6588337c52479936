"""Common behaviour of all commands: errors in one line, exit statuses, interruption, options that are whole numbers."""

import argparse
import errno
import re
import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import NoReturn

from zsdist.common.console import plain, say
from zsdist.errors import ZsdistError

REFUSED = 2
INTERRUPTED = 130
_LINE_END = re.compile(r"\s*\n\s*")  # a message of several lines is shown in one


class Parser(argparse.ArgumentParser):
    """Argument parser that reports an error in one line, without the usage of all options before it."""

    def error(self, message: str) -> NoReturn:
        """Print the error and exit with status 2."""
        self.exit(REFUSED, f"{self.prog}: error: {plain(message)} (--help lists what is allowed)\n")


def execute(
    main: Callable[[argparse.Namespace], int],
    parser: argparse.ArgumentParser,
    arguments: Sequence[str] | None = None,
) -> NoReturn:
    """Run a command and exit with its status; a `--debug` option is added to the parser.

    A `ZsdistError` becomes one line on standard error and status 2, or a traceback and status 1 with `--debug`. So does
    a file name that is too long for the system. Ctrl-C gives status 130, and so does SIGTERM, which a service manager
    sends to stop a command. Any other exception is a defect and keeps its traceback.

    Args:
        main: the command; returns its exit status.
        parser: has the options of the command.
        arguments: used instead of the arguments of the process.
    """
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    options = parser.parse_args(arguments)
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        status = main(options)
    except ZsdistError as error:
        if options.debug:
            raise
        say(f"{parser.prog}: error: {_LINE_END.sub(' ', str(error)).strip()}", error=True)
        status = REFUSED
    except OSError as error:
        if options.debug or error.errno != errno.ENAMETOOLONG:  # only a user can have given such a name
            raise
        say(f"{parser.prog}: error: {error.filename}: {error.strerror}", error=True)
        status = REFUSED
    except KeyboardInterrupt:
        say(f"{parser.prog}: interrupted", error=True)
        status = INTERRUPTED
    finally:
        signal.signal(signal.SIGTERM, before)
    sys.exit(status)


def count(text: str) -> int:
    """Return the value of an option that is a whole number of 1 or more."""
    return _whole_number(text, 1)


def natural(text: str) -> int:
    """Return the value of an option that is a whole number of 0 or more."""
    return _whole_number(text, 0)


def _whole_number(text: str, minimum: int) -> int:
    if not text.isdecimal() or int(text) < minimum:
        raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is a whole number of {minimum} or more")
    return int(text)


def _interrupt(signal_number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt
