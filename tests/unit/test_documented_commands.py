"""Commands of the documents: each is understood by its own parser, and short local ones are run as they are written."""

import importlib
import re
import shlex
import sys

import pytest
from documented import ROOT, commands, tutorial

from zsdist import __main__
from zsdist.common import cli, presets

COMMANDS = commands()
SHORT = (  # as they stand in docs/usage.md
    "evaluate --list",
    "evaluate astar-frontier --scenes configs/scenes",
    "certs DIR --host NAME --actors 16",
)


def test_the_documents_are_read():
    assert len(COMMANDS) > 30 and {"README.md", "docs/usage.md", "deploy/README.md"} <= {c.document for c in COMMANDS}


@pytest.mark.parametrize("command", COMMANDS, ids=str)
def test_a_command_of_the_documents_is_one_that_its_parser_takes(command):
    parser = importlib.import_module(f"zsdist.{command.name}").make_parser()
    options = parser.parse_args(list(command.words))
    if "set" in vars(options):
        cli.overrides(options)
    given = vars(options).get("config")
    assert given is None or presets.find(str(given)) or (ROOT / given).is_file()


@pytest.mark.parametrize("line", SHORT)
def test_a_short_command_of_the_documents_does_its_work_as_it_is_written(tmp_path, monkeypatch, capsys, line):
    assert any(str(command) == f"docs/usage.md {line}" for command in COMMANDS)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["zsdist", *shlex.split(line)])
    with pytest.raises(SystemExit) as exit_:
        __main__.main()
    assert exit_.value.code == 0, capsys.readouterr().err


@pytest.mark.parametrize("document", ["environment"])
def test_the_python_of_a_document_runs(document, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / f"{document}.md").read_text(), re.DOTALL)
    assert len(blocks) > 2
    for number, block in enumerate(blocks):
        if "load_policy" not in block and "async" not in block:  # those take long: `make test-docs`
            exec(compile(block, f"{document}.md, block {number + 1}", "exec"), {"__name__": "__main__"})
    assert "(64, 64, 3)" in capsys.readouterr().out


def test_the_tutorial_shows_what_the_check_of_its_place_prints(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    statuses = []
    for command, shown in tutorial(tmp_path):
        if command.words[:1] == ("check",):
            monkeypatch.setattr(sys, "argv", ["zsdist", command.name, "check", "my-scenes"])
            with pytest.raises(SystemExit) as exit_:
                __main__.main()
            statuses.append(exit_.value.code)
            printed = " ".join(capsys.readouterr().out.split())
            assert " ".join(" ".join(shown[:-1]).split()) in printed  # but for where the drawing is
    assert statuses == [1, 0]


def test_every_preset_is_in_the_document():
    text = (ROOT / "docs" / "usage.md").read_text()
    assert [name for name in presets.names() if f"`{name}`" not in text] == []


def test_every_command_is_in_the_document():
    named = {command.name for command in COMMANDS if command.document == "docs/usage.md"}
    assert set(__main__.describe_commands()) <= named
