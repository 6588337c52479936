"""`zsdist COMMAND`: all commands under one name. Each is a module of its own, which `python -m` runs too.

A command is a module of the package with `make_parser` and `main`. The first line of its docstring describes it.
"""

import ast
import difflib
import importlib
import sys
from pathlib import Path
from typing import NoReturn

import zsdist
from zsdist.common import cli, folders
from zsdist.common.plain_lines import say

_HELP, _VERSION = ("-h", "--help", "help"), ("-V", "--version")


def describe_commands() -> dict[str, str]:
    """Return what each command does, by name in alphabetical order, without importing them."""
    found = {}
    for path in folders.visible(Path(zsdist.__file__).parent, "*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and node.name == "make_parser" for node in tree.body):
            first, *_ = (ast.get_docstring(tree) or path.stem).splitlines()
            found[path.stem] = first.partition(": ")[2]
    return found


def main() -> NoReturn:
    """Run the command that the first argument of this process names, and exit with its status."""
    commands = describe_commands()
    name = sys.argv[1] if len(sys.argv) > 1 else _HELP[0]
    if name in _HELP:
        _show(commands)
        sys.exit(0)
    if name in _VERSION:
        say(f"zsdist {zsdist.__version__}")
        sys.exit(0)
    if name not in commands:
        nearest = difflib.get_close_matches(name, commands, 1)
        meant = f"; did you mean {nearest[0]}?" if nearest else ""
        say(f"zsdist: error: command is {name!r}; allowed are {', '.join(commands)}{meant}", error=True)
        sys.exit(cli.REFUSED)
    del sys.argv[1]  # what follows is as in `python -m zsdist.COMMAND`
    try:
        command = importlib.import_module(f"zsdist.{name}")
    except ModuleNotFoundError as error:
        if cli.is_defect(error):
            raise
        say(f"zsdist {name}: error: {cli.lacking(error)}", error=True)
        sys.exit(cli.REFUSED)
    parser = command.make_parser()
    parser.prog = f"zsdist {name}"
    cli.execute(command.main, parser)


def _show(commands: dict[str, str]) -> None:
    say("usage: zsdist COMMAND [OPTIONS]")
    say("")
    for name, line in commands.items():
        say(f"  {name:10} {line}")
    say("")
    say("zsdist COMMAND --help lists the options of a command.")


if __name__ == "__main__":
    main()
