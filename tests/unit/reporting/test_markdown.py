import re
from html import unescape

import pytest
from hostile import NAMES
from markdown_it import MarkdownIt

from zsdist.common.console import plain
from zsdist.reporting import markdown
from zsdist.reporting.markdown import code, escaped, figure, missing, table

READER = MarkdownIt("commonmark").enable(["table", "strikethrough"])


def read(lines):
    """Return the HTML of a page."""
    return READER.render("\n".join(lines))


def text_of(html):
    return unescape(re.sub(r"<[^>]+>", "", html))


def squeezed(text):
    return "".join(text.split())  # Markdown may drop spaces at the edges of a cell


def test_a_table_in_markdown_has_a_cell_for_each_column():
    lines = table(["a", "b"], [["x", "1"], ["y", "2"]])
    assert lines == ["| a | b |", "| --- | ---: |", "| x | 1 |", "| y | 2 |", ""]


@pytest.mark.parametrize("name", NAMES)
def test_a_page_shows_a_name_as_it_is_in_cells_captions_code_and_notes(name):
    wanted = squeezed(plain(name))
    html = read(table(["name", name, "n"], [[name, code(name), "1"]]))
    found = [text_of(cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", html)]
    assert [squeezed(cell) for cell in found] == ["name", wanted, "n", wanted, wanted, "1"]
    assert squeezed(text_of(read(missing(name)))) == f"Leftout:{wanted}."
    assert wanted in squeezed(text_of(read(figure("a.png", f"Runs of {name}, by seed."))))
    assert squeezed(text_of(read([f"### {code(name)}"]))) == wanted


@pytest.mark.parametrize("name", ["run-3", "no_contrast", "ood-start-goal", "high.learning_rate", "12.0% (3.1-4.5)"])
def test_an_ordinary_name_stays_readable_in_the_source(name):
    assert escaped(name) == name and code(name) == f"`{name}`"


def test_markup_of_our_own_is_not_escaped_again():
    bold = markdown.Markup(f"**{escaped('a*b')}**")
    assert "<strong>a*b</strong>" in read(table(["x"], [[bold]]))


def test_a_figure_is_shown_with_its_caption_and_as_a_drawing():
    lines = figure("paths.png", "Paths. Of two cars.")
    assert lines[0] == "![Paths](paths.png)"
    assert "*Paths. Of two cars.*" in lines[2] and "(paths.svg)" in lines[2]


def test_what_is_missing_comes_with_the_command_that_adds_it():
    assert missing("it", "python -m x 'a b'") == ["Left out: it. Added by:", "", "    python -m x 'a b'", ""]


def test_what_is_missing_is_named_with_the_reason():
    assert missing("it, as there is none") == ["Left out: it, as there is none.", ""]
