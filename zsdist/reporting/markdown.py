"""Tables, figures and notes of reports, in Markdown. Texts are shown as they are, whatever they contain."""

import re
from collections.abc import Sequence

from zsdist.common.console import plain

_SPECIAL = re.compile(r"[\\`*\[\]<>|~$&]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])")  # within a word `_` has no meaning
_TICKS = re.compile("`+")


class Markup(str):
    """Text that is Markdown already, so that it is not escaped again."""


def escaped(text: str) -> Markup:
    """Return a text in one line, as Markdown that shows it as it is."""
    return text if isinstance(text, Markup) else Markup(_SPECIAL.sub(r"\\\g<0>", plain(text)))


def code(text: str) -> Markup:
    """Return a text in one line, as code."""
    shown = plain(text)
    fence = "`" * (1 + max((len(ticks) for ticks in _TICKS.findall(shown)), default=0))
    pad = " " if shown.startswith("`") or shown.endswith("`") or not shown.strip() else ""
    return Markup(f"{fence}{pad}{shown}{pad}{fence}")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a table, first column left-aligned, others right-aligned, with an empty line after it."""
    lines = [f"| {' | '.join(map(_cell, row))} |" for row in (head, *rows)]
    return [lines[0], "|" + "|".join([" --- ", *[" ---: "] * (len(head) - 1)]) + "|", *lines[1:], ""]


def figure(file: str, caption: str) -> list[str]:
    """Return a picture with its caption and a link to its SVG."""
    drawing = file.removesuffix(".png") + ".svg"
    first = escaped(caption.split(". ")[0])
    return [f"![{first}]({file})", "", f"*{escaped(caption)}* ([SVG]({drawing}))", ""]


def missing(reason: str, command: str = "") -> list[str]:
    """Return a line that names what is not shown, and the reason; and one with the command that adds it, if any."""
    if not command:
        return [f"Left out: {escaped(reason)}.", ""]
    return [f"Left out: {escaped(reason)}. Added by:", "", f"    {plain(command)}", ""]


def _cell(text: str) -> str:
    """Return the content of a cell; a bar in it is escaped, in code too, as tables demand."""
    return re.sub(r"(?<!\\)((?:\\\\)*)\|", r"\1\\|", escaped(text))
