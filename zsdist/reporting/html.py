"""One HTML file of a Markdown page, with its pictures inside: it can be mailed, and needs nothing else to be read."""

import base64
import mimetypes
from collections.abc import Iterator, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote

from markdown_it import MarkdownIt
from markdown_it.token import Token

from zsdist.errors import RunError

_FRAME = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ margin: 0 auto; padding: 1rem; max-width: 62rem; font: 16px/1.5 system-ui, sans-serif;
  background: light-dark(#fff, #12161b); color: light-dark(#1b2026, #e6eaef); overflow-wrap: break-word; }}
a {{ color: light-dark(#0b5c8a, #7cc4f2); }}
img {{ max-width: 100%; height: auto; background: #fff; }}
table {{ border-collapse: collapse; display: block; overflow-x: auto; font-size: .9rem; }}
th, td {{ padding: .25rem .75rem .25rem 0; border-bottom: 1px solid; white-space: nowrap; }}
pre {{ overflow-x: auto; padding: .5rem; background: light-dark(#f0f2f5, #1b2128); }}
nav li {{ display: inline-block; margin-right: 1rem; }}
nav ul {{ padding: 0; }}
</style>
</head>
<body>
<nav aria-label="Contents"><ul>
{contents}
</ul></nav>
<main>
{body}</main>
</body>
</html>
"""


def write(page: Path) -> Path:
    """Write a Markdown page as an HTML file beside it; files that it shows or links to are put inside.

    Args:
        page: page with pictures and links relative to its folder.

    Returns:
        The HTML file.

    Raises:
        RunError: a file cannot be read or written.
    """
    reader = MarkdownIt("commonmark", {"html": False}).enable(["table", "strikethrough"])
    out = page.with_suffix(".html")
    try:
        tokens = reader.parse(page.read_text(encoding="utf-8"))
        headings = _number_headings(tokens)
        for token in _all(tokens):
            _put_inside(token, page.parent)
        body = reader.renderer.render(tokens, reader.options, {})
        title = next((text for tag, _, text in headings if tag == "h1"), page.stem)
        parts = [f'<li><a href="#{name}">{escape(text)}</a></li>' for tag, name, text in headings if tag == "h2"]
        out.write_text(_FRAME.format(title=escape(title), contents="\n".join(parts), body=body), encoding="utf-8")
    except OSError as error:
        raise RunError(f"{error.filename or out} cannot be written or read: {error.strerror or error}") from error
    return out


def _number_headings(tokens: Sequence[Token]) -> list[tuple[str, str, str]]:
    """Give headings names to link to, and return tag, name and text of each."""
    headings: list[tuple[str, str, str]] = []
    for token, content in pairwise(tokens):
        if token.type == "heading_open":
            name = f"part-{len(headings)}"
            token.attrSet("id", name)
            headings.append((token.tag, name, "".join(child.content for child in content.children or [])))
    return headings


def _all(tokens: Sequence[Token]) -> Iterator[Token]:
    for token in tokens:
        yield token
        yield from _all(token.children or [])


def _put_inside(token: Token, folder: Path) -> None:
    """Replace the file that a picture or a link names by its content."""
    name = {"image": "src", "link_open": "href"}.get(token.type)
    place = str(token.attrGet(name) or "") if name is not None else ""
    if name is None or "://" in place or place.startswith("#"):
        return
    file = folder / unquote(place)
    kind = mimetypes.guess_type(file.name)[0] or "application/octet-stream"
    token.attrSet(name, f"data:{kind};base64,{base64.b64encode(file.read_bytes()).decode()}")
    if name == "href":
        token.attrSet("download", file.name)  # browsers follow no link to such an address, and save it
