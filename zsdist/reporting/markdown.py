"""The little Markdown that reports are written in."""

from collections.abc import Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table, the first column to the left, the others to the right; an empty line after it."""
    lines = [f"| {' | '.join(row)} |" for row in (head, *rows)]
    return [lines[0], "|" + "|".join([" --- ", *[" ---: "] * (len(head) - 1)]) + "|", *lines[1:], ""]


def figure(file: str, caption: str) -> list[str]:
    """A picture with its caption, and where the same lies as a drawing."""
    drawing = file.removesuffix(".png") + ".svg"
    return [f"![{caption.split('. ')[0]}]({file})", "", f"*{caption}* ([SVG]({drawing}))", ""]


def missing(what: str) -> list[str]:
    """A line that says what is not shown, and why."""
    return [f"Left out: {what}.", ""]
