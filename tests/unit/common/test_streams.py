import contextlib
import errno
import os
import subprocess
import sys

import pytest

from zsdist.common import signals, streams
from zsdist.errors import RunError

COMMAND = """
import argparse, sys
from zsdist.common import cli, streams
def main(options):
    {body}
    return 0
cli.execute(main, cli.Parser(prog="zsdist.command"), [])
"""
TALK = "print('x' * 100_000, flush=True)"


def talk(stdout, body=TALK, **options):
    code = COMMAND.format(body=body)
    return subprocess.run(
        [sys.executable, "-c", code], stdout=stdout, stderr=subprocess.PIPE, text=True, check=False, **options
    )


@contextlib.contextmanager
def closed_pipe():
    reader, writer = os.pipe()
    os.close(reader)
    try:
        yield writer
    finally:
        os.close(writer)


@pytest.mark.parametrize("body", [TALK, "print('held back until the end')"])
def test_a_command_whose_output_nobody_reads_ends_quietly_as_by_sigpipe(body):
    with closed_pipe() as writer:
        done = talk(writer, body)
    assert (done.returncode, done.stderr) == (141, "")


def test_a_command_of_which_nobody_reads_output_and_errors_ends_as_by_sigpipe():
    with closed_pipe() as writer:
        code = COMMAND.format(body=TALK)
        done = subprocess.run([sys.executable, "-c", code], stdout=writer, stderr=writer, check=False)
    assert done.returncode == 141


def test_output_that_a_full_disk_does_not_take_is_an_error_after_the_work():
    with open("/dev/full", "w") as full:
        done = talk(full, f"{TALK}; {TALK}; print('done', file=sys.stderr)")
    assert done.returncode == 2
    assert done.stderr == "done\nzsdist.command: error: standard output cannot be written: No space left on device\n"


def test_no_file_takes_the_place_of_a_closed_output(tmp_path):
    file = tmp_path / "file"
    body = f"file = open({str(file)!r}, 'w'); print('text', flush=True); streams.tell('text')"
    done = talk(None, body, preexec_fn=lambda: os.close(1))
    assert done.returncode == 0, done.stderr
    assert file.read_text() == ""


def test_a_last_line_is_told_where_it_can_be_read():
    body = f"""
    try:
        {TALK}
    except KeyboardInterrupt:
        streams.tell("resume")
        raise"""
    with closed_pipe() as writer:
        done = talk(writer, body)
    assert (done.returncode, done.stderr) == (141, "resume\n")


class DeadTerminal:
    def write(self, text):
        raise OSError(errno.EIO, "Input/output error")

    flush = fileno = lambda self: self.write("")


def test_a_lost_terminal_stops_no_work_and_is_reported_once_it_is_checked():
    stream = streams.GuardedStream(DeadTerminal(), "standard output")
    with signals.handled_by(signals.Interruption()) as interruption:
        assert stream.write("text") == 4
        stream.flush()
    assert not interruption()
    with pytest.raises(RunError, match="standard output cannot be written: Input/output error"):
        stream.check()
