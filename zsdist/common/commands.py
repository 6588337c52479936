"""Commands that are printed for users, quoted so that they can be pasted into a shell."""

import argparse
import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

_SCRIPT = "zsdist"  # the script that pip installs


def quoted(*words: object) -> str:
    r"""Return words as a POSIX shell reads them back, in one line.

    A word with control characters or undecodable bytes is written as bash, zsh and ksh read it: `$'a\nb'`.
    """
    return " ".join(_quoted(str(word)) for word in words)


def module(name: str, *words: object) -> str:
    """Return the command that runs a module of zsdist with arguments, such as `python -m zsdist.report 'my run'`.

    In a process that was started by the script `zsdist` it is `zsdist report 'my run'`.

    Args:
        name: name of the module, such as `zsdist.report`.
        words: arguments; a path is given as an absolute one, so that the command works in any folder.
    """
    script = _script()
    program = (python(), "-m", name) if script is None else (script, name.partition(".")[2])
    return quoted(*program, *(word.absolute() if isinstance(word, Path) else word for word in words))


def python() -> str:
    """Return the name of this interpreter: `python` or `python3` where the shell finds it there, else its path."""
    for name in ("python", "python3"):
        found = shutil.which(name)
        if found is not None and sys.executable and _is_this_interpreter(found):
            return name
    return sys.executable or "python"


def repeated(parser: argparse.ArgumentParser, options: argparse.Namespace, names: Sequence[str]) -> list[str]:
    """Return the words of those options that differ from their defaults, so that a printed command has them too.

    Args:
        parser: parser of the options.
        options: options as they were parsed.
        names: names of the options without their dashes, such as `keep-pictures`.
    """
    words = []
    for name in names:
        value, default = (given(name.replace("-", "_")) for given in (vars(options).get, parser.get_default))
        if value is True:
            words.append(f"--{name}")
        elif value is not None and value != default:
            values = value if isinstance(value, list) else [value]
            words += [f"--{name}={one.absolute() if isinstance(one, Path) else one}" for one in values]
    return words


def _script() -> str | None:
    """Return how a shell calls the script `zsdist` that started this process; None where another program did."""
    script = Path(sys.argv[0]) if sys.argv else Path()
    if script.name != _SCRIPT or not script.is_file():
        return None
    found = shutil.which(_SCRIPT)
    return _SCRIPT if found is not None and os.path.samefile(found, script) else str(script.absolute())


def _is_this_interpreter(found: str) -> bool:
    same_folder = os.path.realpath(Path(found).parent) == os.path.realpath(Path(sys.executable).parent)
    return same_folder and os.path.realpath(found) == os.path.realpath(sys.executable)


def _quoted(word: str) -> str:
    if word.isprintable():
        return shlex.quote(word)
    written = "".join(_escaped(character) for character in word)
    return f"$'{written}'"


def _escaped(character: str) -> str:
    if character in "'\\":
        return f"\\{character}"
    if character.isprintable():
        return character
    return "".join(f"\\x{byte:02x}" for byte in os.fsencode(character))
