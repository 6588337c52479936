"""The laws of output: one place prints, one place writes commands, and both take any text."""

import argparse
import ast
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

import zsdist

PACKAGE = Path(zsdist.__file__).parent
TREES = {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob("*.py"))}
PRINTERS, COMMANDS = ("common/console.py", "common/plain_lines.py"), "common/commands.py"
OF_RICH = {  # read no markup
    *("rich.live.Live", "rich.table.Table", "rich.progress.Progress", "rich.progress.TaskID", "rich.text.Text"),
    *("rich.console.ConsoleOptions", "rich.console.RenderResult"),
}


def unsafe_output(tree: ast.Module) -> list[str]:
    """Ways to print of which some swallow or obey a text."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.split(".")[0] == "rich"]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "rich":
            found += [name for alias in node.names if (name := f"{node.module}.{alias.name}") not in OF_RICH]
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            if called in ("Table", "rich.table.Table", "Progress"):
                found.append(f"{called}()")
            elif called == "print" and not (node.args and ast.unparse(node.args[0]).startswith("json.dumps(")):
                found.append("print()")
            elif called.endswith(".from_markup") or called in ("sys.stdout.write", "sys.stderr.write"):
                found.append(called)
            found += [f"{called}({word.arg}=)" for word in node.keywords if word.arg in ("markup", "emoji")]
    return found


def loose_commands(tree: ast.Module) -> list[str]:
    """Commands with a value that is put in without quotes."""
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.JoinedStr):
            continue
        shape = "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
        if re.search(r"(python\S* -m |--resume |chmod |rm )[^;,]*\{\}", shape) and not shape.startswith("--resume {}"):
            found.append(shape)
    return found


def fixed_commands(tree: ast.Module) -> list[str]:
    """Commands in texts that have no value put in, as `zsdist.module words`."""
    texts = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    return [found for text in texts for found in re.findall(r"python -m (zsdist\.\w+(?: --[a-z-]+)*)", text)]


def test_texts_are_printed_by_the_one_place_that_shows_them_as_they_are():
    others = {name: found for name, tree in TREES.items() if name not in PRINTERS and (found := unsafe_output(tree))}
    assert others == {}


@pytest.mark.parametrize(
    "line",
    [
        "from rich.console import Console",
        "import rich",
        "from rich import print",
        "text = Text.from_markup(name)",
        "print(name)",
        "sys.stderr.write(name)",
        "table = Table(title=name)",
        "console.print(name, markup=True)",
        "TextColumn(name, markup=True)",
    ],
)
def test_the_reader_of_output_notices_a_way_that_reads_markup(line):
    assert unsafe_output(ast.parse(line))


def test_commands_with_a_value_are_quoted_by_the_one_place_that_knows_how():
    others = {name: found for name, tree in TREES.items() if name != COMMANDS and (found := loose_commands(tree))}
    assert others == {}


@pytest.mark.parametrize(
    "line",
    [
        'f"resume with python -m zsdist.launch --resume {folder}"',
        'f"allowed are a new folder or --resume {folder}"',
        'f"chmod 600 {key}"',
    ],
)
def test_the_reader_of_commands_notices_a_value_without_quotes(line):
    assert loose_commands(ast.parse(line))


def test_commands_in_texts_are_understood_by_their_own_parsers():
    fixed = {command for tree in TREES.values() for command in fixed_commands(tree)}
    assert fixed
    for command in fixed:
        module, *words = shlex.split(command)
        parser: argparse.ArgumentParser = import_module(module).make_parser()
        known = {option for option in words if option in parser.format_help()}
        assert known == set(words), command
