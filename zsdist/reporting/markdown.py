"""Tables, figures and notes of reports, in Markdown."""

from collections.abc import Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a table, first column left-aligned, others right-aligned, with an empty line after it."""
    lines = [f"| {' | '.join(row)} |" for row in (head, *rows)]
    return [lines[0], "|" + "|".join([" --- ", *[" ---: "] * (len(head) - 1)]) + "|", *lines[1:], ""]


def figure(file: str, caption: str) -> list[str]:
    """Return a picture with its caption and a link to its SVG."""
    drawing = file.removesuffix(".png") + ".svg"
    return [f"![{caption.split('. ')[0]}]({file})", "", f"*{caption}* ([SVG]({drawing}))", ""]


def missing(reason: str) -> list[str]:
    """Return a line that names what is not shown, and the reason."""
    return [f"Left out: {reason}.", ""]
