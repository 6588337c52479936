import base64
import re

import pytest

from zsdist.errors import RunError
from zsdist.reporting import html
from zsdist.reporting.markdown import code, figure, table

PICTURE, DRAWING = b"\x89PNG picture", b"<svg/>"


@pytest.fixture
def page(tmp_path):
    (tmp_path / "a b.png").write_bytes(PICTURE)
    (tmp_path / "fig.png").write_bytes(PICTURE)
    (tmp_path / "fig.svg").write_bytes(DRAWING)
    lines = ["# Report <1>", "", "## First & last", "", *figure("fig.png", "What is <b>shown</b>. More")]
    lines += [*table(("run", "success"), [[code("a|b"), "0.9"]]), "![x](a%20b.png)", "[site](https://example.org)"]
    (tmp_path / "report.md").write_text("\n".join(lines))
    return tmp_path / "report.md"


def test_pictures_and_files_of_a_page_are_inside_and_nothing_else_is_asked_for(page):
    text = html.write(page).read_text()
    shown = re.findall(r'src="data:image/png;base64,([^"]*)"', text)
    assert [base64.b64decode(content) for content in shown] == [PICTURE] * 2
    (drawing,) = re.findall(r'href="data:image/svg\+xml;base64,([^"]*)" download="fig.svg"', text)
    assert base64.b64decode(drawing) == DRAWING
    assert not re.search(r'src="(?!data:)|<script|<link', text) and 'href="https://example.org"' in text


def test_texts_of_a_page_are_shown_as_they_are(page):
    text = html.write(page).read_text()
    assert "<title>Report &lt;1&gt;</title>" in text and "&lt;b&gt;shown" in text and "<code>a|b</code>" in text
    assert '<li><a href="#part-1">First &amp; last</a></li>' in text and '<h2 id="part-1">' in text


def test_a_picture_that_is_missing_is_named(page):
    (page.parent / "fig.png").unlink()
    with pytest.raises(RunError, match=r"fig\.png cannot be"):
        html.write(page)
