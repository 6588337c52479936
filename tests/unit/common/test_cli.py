import argparse
import os
import signal
import subprocess
import sys

import pytest

from zsdist import config
from zsdist.common import cli, output_files, signals
from zsdist.errors import ConfigError


def leave(main, arguments=()):
    parser = cli.Parser(prog="zsdist.command")
    parser.add_argument("--actors", type=int)
    with pytest.raises(SystemExit) as exit_:
        cli.execute(main, parser, arguments)
    return exit_.value.code


def refuse(_options):
    raise ConfigError("run.actors is 0:\nallowed is 1 or more")


def interrupt(_options):
    raise KeyboardInterrupt


def test_the_status_of_the_command_is_the_status_of_the_process():
    assert leave(lambda options: options.actors, ["--actors", "7"]) == 7


def test_an_error_is_one_line_and_status_2(capsys):
    assert leave(refuse) == 2
    assert capsys.readouterr().err == "zsdist.command: error: run.actors is 0: allowed is 1 or more\n"


def test_debug_shows_the_traceback():
    with pytest.raises(ConfigError):
        cli.execute(refuse, cli.Parser(prog="zsdist.command"), ["--debug"])


def test_a_wrong_option_is_one_line_and_status_2(capsys):
    assert leave(refuse, ["--actors", "many"]) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1 and "--actors" in complaint and "many" in complaint


@pytest.mark.parametrize(("text", "number"), [("12", 12), ("0012", 12), ("1e3", 1000), (" 7 ", 7), ("1_000", 1000)])
def test_an_option_takes_a_whole_number_as_a_configuration_does(text, number):
    assert cli.whole(text) == cli.count(text) == cli.natural(text) == number
    assert config.load(None, (f"run.episodes={text}",)).run.episodes == number


@pytest.mark.parametrize("text", ["1.5", "many", "", "0x10", "nan", "1e-3", "\u0661"])
def test_an_option_refuses_what_is_no_whole_number(text):
    for reader in (cli.whole, cli.count, cli.natural):
        with pytest.raises(argparse.ArgumentTypeError, match="allowed is a whole number"):
            reader(text)


def test_ctrl_c_is_status_130():
    assert leave(interrupt) == 130


@pytest.mark.parametrize("number", signals.STOPPING)
def test_a_signal_that_asks_to_stop_is_named_and_gives_its_status(capsys, number):
    before = signal.getsignal(number)
    assert leave(lambda options: os.kill(os.getpid(), number)) == 128 + number
    assert capsys.readouterr().err == f"zsdist.command: interrupted by {signals.name_of(number)}\n"
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", output_files.OF_THE_SYSTEM)
def test_an_error_that_only_the_system_makes_is_one_line(capsys, number):
    def fail(options):
        raise OSError(number, os.strerror(number), "runs/x")

    assert leave(fail) == 2
    assert capsys.readouterr().err == f"zsdist.command: error: runs/x: {os.strerror(number)}\n"


def test_a_ctrl_c_while_a_command_is_imported_leaves_no_traceback():
    code = "import sys; sys.orig_argv[1:] = ['-m', 'zsdist.launch']; import zsdist; import os; os.kill(os.getpid(), 2)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


@pytest.mark.parametrize(("kind", "least"), [(cli.count, 1), (cli.natural, 0)])
def test_whole_numbers_below_the_minimum_are_refused(kind, least):
    assert kind(str(least)) == least
    for wrong in (str(least - 1), "many", "1.5", ""):
        with pytest.raises(argparse.ArgumentTypeError, match=f"allowed is a whole number of {least} or more"):
            kind(wrong)


def test_a_defect_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError):
        cli.execute(lambda options: 1 // 0, cli.Parser(), [])
