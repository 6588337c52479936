"""The script `zsdist`: all commands under one name."""

import ast
import re
import sys
from pathlib import Path

import pytest

import zsdist
from zsdist import __main__

PACKAGE = Path(zsdist.__file__).parent


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["zsdist", *words])
    with pytest.raises(SystemExit) as exit_:
        __main__.main()
    return exit_.value.code


def test_every_module_that_is_run_as_a_command_is_one_and_says_what_it_does():
    run_by_m = {path.stem for path in PACKAGE.glob("*.py") if 'if __name__ == "__main__"' in path.read_text()}
    found = __main__.describe_commands()
    assert set(found) == run_by_m - {"__main__"}
    for name, line in found.items():
        first = ast.get_docstring(ast.parse((PACKAGE / f"{name}.py").read_text())).splitlines()[0]
        assert re.match(rf"`python -m zsdist\.{name}\b.*`: ", first) and len(line) > 10, name


@pytest.mark.parametrize("words", [(), ("--help",), ("help",)])
def test_without_a_command_all_are_listed(monkeypatch, capsys, words):
    assert run(monkeypatch, *words) == 0
    listed = capsys.readouterr().out
    assert all(f"  {name} " in listed for name in __main__.describe_commands())


def test_a_command_gets_the_words_behind_its_name_and_its_help_bears_that_name(monkeypatch, capsys):
    assert run(monkeypatch, "evaluate", "--list") == 0
    assert "pretrained" in capsys.readouterr().out
    assert run(monkeypatch, "doctor", "--help") == 0
    assert capsys.readouterr().out.startswith("usage: zsdist doctor ")
    assert run(monkeypatch, "evaluate", "--what") == 2
    assert capsys.readouterr().err.startswith("zsdist evaluate: error: ")


def test_an_unknown_command_is_answered_in_one_line_with_the_nearest(monkeypatch, capsys):
    assert run(monkeypatch, "lauch") == 2
    error = capsys.readouterr().err
    assert "command is 'lauch'; allowed are certs, doctor," in error and "did you mean launch?" in error
    assert error.count("\n") == 1


def test_the_version_is_printed(monkeypatch, capsys):
    assert run(monkeypatch, "--version") == 0
    assert capsys.readouterr().out == f"zsdist {zsdist.__version__}\n"
