import argparse
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hostile import NAMES

from zsdist.common import commands

BASH = shutil.which("bash")
FILE_NAMES = [name for name in NAMES if "\x00" not in name and "\ud800" not in name]


@pytest.mark.parametrize("name", [name for name in FILE_NAMES if name.isprintable()] + [""])
def test_words_are_read_back_by_a_posix_shell(name):
    assert shlex.split(commands.quoted("--run-dir", name)) == ["--run-dir", name]


@pytest.mark.skipif(BASH is None, reason="bash is not installed")
@pytest.mark.parametrize("name", FILE_NAMES)
def test_words_are_read_back_by_bash_and_stand_in_one_printable_line(name):
    line = commands.quoted("printf", "%s", name)
    assert line.isprintable()
    assert subprocess.run([BASH, "-c", line], capture_output=True, check=True).stdout == os.fsencode(name)


def test_a_module_is_run_by_this_interpreter_with_paths_that_hold_in_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    python, *words = shlex.split(commands.module("zsdist.launch", "--resume", Path("-my runs")))
    assert words == ["-m", "zsdist.launch", "--resume", str(tmp_path / "-my runs")]
    found = shutil.which(python)
    code = "import sys; print(sys.executable, sys.prefix)"
    said = subprocess.run([found, "-c", code], capture_output=True, check=True, text=True).stdout.split()
    assert said[1] == sys.prefix


def test_the_script_of_the_package_repeats_itself_as_the_shell_finds_it(tmp_path, monkeypatch):
    script = tmp_path / "bin" / "zsdist"
    script.parent.mkdir()
    script.touch(mode=0o755)
    monkeypatch.setattr(sys, "argv", [str(script), "--episodes", "3"])
    monkeypatch.setenv("PATH", str(tmp_path))
    assert commands.module("zsdist.report", "my run") == f"{script} report 'my run'"
    monkeypatch.setenv("PATH", str(script.parent))
    assert commands.module("zsdist.report", "my run") == "zsdist report 'my run'"


def test_python_is_named_only_where_the_shell_finds_this_interpreter_under_the_name(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert commands.python() == sys.executable
    (tmp_path / "python").symlink_to(sys.executable)
    assert commands.python() == sys.executable  # it begins another environment
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent))
    assert commands.python() in ("python", "python3")


def test_options_are_repeated_where_they_differ_from_their_defaults(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    parser = argparse.ArgumentParser()
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--keep-pictures", action="store_true")
    parser.add_argument("--minutes", type=float, default=9.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--set", action="append", default=[])
    names = ("plain", "keep-pictures", "minutes", "json", "set")
    given = parser.parse_args(["--keep-pictures", "--minutes=2.5", "--json", "my file", "--set=a=b c", "--set", "d=-1"])
    again = commands.repeated(parser, given, names)
    assert parser.parse_args(shlex.split(commands.quoted(*again))) == argparse.Namespace(
        plain=False, keep_pictures=True, minutes=2.5, json=tmp_path / "my file", set=["a=b c", "d=-1"]
    )
    assert commands.repeated(parser, parser.parse_args([]), names) == []
