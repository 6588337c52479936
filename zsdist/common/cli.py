"""Common behaviour of all commands: errors in one line, exit statuses, interruption, options that are whole numbers."""

import argparse
import signal
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from zsdist.common import output_files, signals, streams
from zsdist.errors import ZsdistError

REFUSED = 2


class Parser(argparse.ArgumentParser):
    """Argument parser that reports an error in one line, without the usage of all options before it."""

    def error(self, message: str) -> NoReturn:
        """Print the error and exit with status 2."""
        self.exit(REFUSED, f"{self.prog}: error: {message} (--help lists what is allowed)\n")


def execute(
    main: Callable[[argparse.Namespace], int],
    parser: argparse.ArgumentParser,
    arguments: Sequence[str] | None = None,
) -> NoReturn:
    """Run a command and exit with its status; a `--debug` option is added to the parser.

    A `ZsdistError` becomes one line on standard error and status 2, or a traceback and status 1 with `--debug`. So does
    an error of the system in `output_files.OF_THE_SYSTEM`. A signal of `signals.STOPPING` gives 128 plus its number; so
    does SIGPIPE, when nobody reads the output any longer. Any other exception is a defect and keeps its traceback.

    Args:
        main: the command; returns its exit status.
        parser: has the options of the command.
        arguments: used instead of the arguments of the process.
    """
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    with signals.handled_by(signals.Interruption(at_once=True)), streams.guarded():
        try:
            status = _execute(main, parser, arguments)
        except KeyboardInterrupt as interruption:
            status = _report(parser.prog, interruption)
    sys.exit(status)


def _execute(
    main: Callable[[argparse.Namespace], int], parser: argparse.ArgumentParser, arguments: Sequence[str] | None
) -> int:
    options = parser.parse_args(arguments)
    try:
        status = main(options)
        streams.check_output()
        return status
    except ZsdistError as error:
        if options.debug:
            raise
        print(f"{parser.prog}: error: {' '.join(str(error).split())}", file=sys.stderr)
    except OSError as error:
        if options.debug or error.errno not in output_files.OF_THE_SYSTEM:
            raise
        place = "" if error.filename is None else f"{error.filename}: "
        print(f"{parser.prog}: error: {place}{error.strerror}", file=sys.stderr)
    return REFUSED


def _report(prog: str, interruption: KeyboardInterrupt) -> int:
    """Say which signal has stopped a command, and return its exit status."""
    number = signals.number_of(interruption)
    if number != signal.SIGPIPE:
        print(f"{prog}: interrupted by {signals.name_of(number)}", file=sys.stderr)
    return signals.status_of(interruption)


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
