"""Common behaviour of all commands: errors in one line, exit statuses, interruption, and options of common kinds.

An option that stands for a setting is added by `Parser.add_setting`. `overrides` returns what all such options and
`--set` say, and refuses options that contradict each other.
"""

import argparse
import contextlib
import json
import re
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from zsdist import config
from zsdist.common import output_files, places, presets, signals, streams, values
from zsdist.common.allowed_resources import allowed_cores
from zsdist.common.plain_lines import plain, say
from zsdist.errors import ConfigError, ZsdistError

REFUSED = 2
_LINE_END = re.compile(r"\s*\n\s*")  # a message of several lines is shown in one


class Parser(argparse.ArgumentParser):
    """Argument parser that reports an error in one line, without the usage of all options before it."""

    def add_setting(self, option: str, *settings: str, group: Any = None, **arguments: Any) -> None:
        """Add an option that stands for settings.

        Args:
            option: name of the option.
            settings: path of the setting that has the option's value; or, for an option without a value, settings with
                their values, as `key.path=value`.
            group: group of the help that lists it, from `add_argument_group`; None: the general one.
            arguments: further arguments of `add_argument`.
        """
        action = (group or self).add_argument(option, **arguments)
        self.set_defaults(stands_for={**(self.get_default("stands_for") or {}), action.dest: settings})

    def add_set(self, group: Any = None) -> None:
        """Add `--set`, in a group of the help or among the general options."""
        (group or self).add_argument(
            "--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change one setting; repeatable"
        )

    def add_drives(self) -> None:
        """Add `--config`, `--set` and `--workers`, for a command that drives a policy in parallel processes."""
        world = "preset or file of a baseline's world; a run has its own"
        self.add_argument("--config", type=configuration, metavar="FILE", help=world)
        self.add_set()
        self.add_workers()

    def add_workers(self) -> None:
        """Add `--workers`."""
        processes = "processes (default: one per core that this process may use)"
        self.add_argument("--workers", type=count, default=allowed_cores(), metavar="N", help=processes)

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
        say(f"{parser.prog}: error: {_LINE_END.sub(' ', str(error)).strip()}", error=True)
    except ModuleNotFoundError as error:
        if options.debug or is_defect(error):
            raise
        say(f"{parser.prog}: error: {lacking(error)}", error=True)
    except OSError as error:
        if options.debug or error.errno not in output_files.OF_THE_SYSTEM:
            raise
        place = "" if error.filename is None else f"{error.filename}: "
        say(f"{parser.prog}: error: {place}{error.strerror}", error=True)
    return REFUSED


def is_defect(error: ModuleNotFoundError) -> bool:
    """Return whether a module is missing that belongs to this package, rather than one that it needs."""
    return error.name is None or error.name.partition(".")[0] == __name__.partition(".")[0]


def lacking(error: ModuleNotFoundError) -> str:
    """Return one line about a package that is missing, such as one of training where only a runner is installed."""
    return (
        f"Python module {error.name} is not installed here; allowed is an installation of the whole system, by "
        "`pip install .` or `make install`"
    )


def _report(prog: str, interruption: KeyboardInterrupt) -> int:
    """Say which signal has stopped a command, and return its exit status."""
    number = signals.number_of(interruption)
    if number != signal.SIGPIPE:
        say(f"{prog}: interrupted by {signals.name_of(number)}", error=True)
    return signals.status_of(interruption)


def overrides(options: argparse.Namespace) -> tuple[str, ...]:
    """Return the settings that `--set` and the options of `Parser.add_setting` change, as `key.path=value`.

    Raises:
        ConfigError: two of them give a setting different values; the message names both.
    """
    said = [(f"--set {text}", text) for text in options.set]
    for name, settings in getattr(options, "stands_for", {}).items():
        value, option = getattr(options, name), f"--{name.replace('_', '-')}"
        if value is not None and value is not False:
            said += [(option if value is True else f"{option} {value}", _override(text, value)) for text in settings]
    found: dict[str, tuple[str, Any]] = {}
    for words, text in said:
        for key, value in config.leaves_of(text).items():
            annotation = values.find_type(config.Config, key)
            with contextlib.suppress(ValueError):  # the check of the settings reports it
                value = values.typed(annotation, value)
            before, other = found.setdefault(key, (words, value))
            if repr(other) != repr(value):  # NaN does not equal itself
                raise ConfigError(f"{before} and {words} give {key} different values; give one of the two")
    return tuple(text for _, text in said)


def _override(setting: str, value: Any) -> str:
    """Return an override from the setting that an option stands for, and the option's value."""
    return setting if "=" in setting else f"{setting}={value}"


def absolute_override(text: str) -> str:
    """Return an override of one setting that is a path with the absolute path, and any other one as it is."""
    leaves = config.leaves_of(text)
    key = next(iter(leaves))
    place = values.find_place(dict(values.leaves(config.Config)).get(key))
    value = values.typed(values.find_type(config.Config, key), leaves[key])
    if len(leaves) > 1 or place is None or value is None:
        return text
    found = [place.resolve(name) for name in value] if isinstance(value, list) else place.resolve(value)
    return f"{key}={json.dumps(found, ensure_ascii=False)}"


def path(text: str) -> Path:
    """Return the value of an option that is a path, with `~` as the home folder."""
    if not text:
        raise argparse.ArgumentTypeError("path is empty; allowed is a file or a folder, such as . for this one")
    try:
        return places.expand(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error}") from error


def configuration(text: str) -> Path | str:
    """Return the value of an option that is a configuration: the name of a preset, or a path."""
    return text if presets.find(text) is not None else path(text)


def whole(text: str) -> int:
    """Return the value of an option that is a whole number, written as in a configuration: 12, 0012 or 1e3."""
    try:
        found: int = values.number(text, whole=True)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"value is {text!r}; {error}") from error
    return found


def count(text: str) -> int:
    """Return the value of an option that is a whole number of 1 or more."""
    return _whole_number(text, 1)


def natural(text: str) -> int:
    """Return the value of an option that is a whole number of 0 or more."""
    return _whole_number(text, 0)


def _whole_number(text: str, minimum: int) -> int:
    try:
        found: int = values.number(text, whole=True)
    except ValueError:
        found = minimum - 1
    if found < minimum:
        raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is a whole number of {minimum} or more")
    return found
