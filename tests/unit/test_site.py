"""Site of the documentation: its pages are in the navigation, their links lead somewhere, and its reference is whole.

The site itself is built by `make docs`, with its generator.
"""

import html
import importlib
import re
import sys
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import pytest
import yaml
from markdown_it import MarkdownIt

from zsdist.__main__ import describe_commands
from zsdist.common.values import leaves
from zsdist.config import Config

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "docs"))  # scripts, no package
pages, reference, build_site = map(importlib.import_module, ("pages", "reference", "build_site"))
DOCUMENTS = sorted(pages.documents())
PARSER = MarkdownIt("commonmark").enable("table")


class Configuration(yaml.SafeLoader):
    """Loader that takes the names of Python in a configuration of the site as texts."""


Configuration.add_multi_constructor("tag:yaml.org,2002:python/", lambda *_: None)


@cache
def tokens(path):
    return PARSER.parse(path.read_text())


@cache
def anchors(path):
    """Return the anchors of a document's headings as code hosts make them."""
    found = set()
    headings = [tokens(path)[i + 1] for i, token in enumerate(tokens(path)) if token.type == "heading_open"]
    for heading in headings:
        text = "".join(child.content for child in heading.children)
        name = re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
        found.add(next(each for n in range(99) if (each := f"{name}-{n}" if n else name) not in found))
    return found


def links(path):
    inline = [child for token in tokens(path) for child in token.children or () if token.type == "inline"]
    return [str(value) for child in inline for key in ("href", "src") if (value := child.attrGet(key))]


def navigation(entry):
    if isinstance(entry, str):
        return [entry]
    return [name for each in (entry.values() if isinstance(entry, dict) else entry) for name in navigation(each)]


def test_every_document_is_in_the_navigation_once():
    configuration = yaml.load((ROOT / "docs" / "mkdocs.yml").read_text(), Configuration)
    named = navigation(configuration["nav"])
    generated = {"reference/settings.md", "reference/commands.md", "reference/python.md"}
    assert sorted(named) == sorted({*pages.documents().values(), *generated})


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_link_of_a_document_leads_to_a_file_and_a_place_in_it(document):
    wrong = []
    for link in links(document):
        if re.match(r"[a-z]+:", link):
            wrong += [] if re.fullmatch(r"https?://[\w.-]+\.\w+(/\S*)?|mailto:\S+@\S+", link) else [link]
            continue
        name, _, anchor = unquote(link).partition("#")
        target = document.parent / name if name else document
        if not target.exists() or (anchor and anchor not in anchors(target)):
            wrong.append(link)
    assert wrong == []


def test_the_reference_names_and_explains_every_setting_with_its_default_and_its_range():
    rows = {row[0]: row for row in map(split_row, reference.settings().splitlines()) if row}
    for path, _ in leaves(Config):
        _, default, allowed, meaning = rows[path]
        assert default and allowed and meaning, path
    assert rows["run.actors"][1:3] == ["2", "whole number, 1 to 4,096"]
    assert rows["camera.back_end"][1:3] == ["caster", "caster, pybullet"]
    assert rows["agent.epsilon_min"][2] == "number, 0 to 1"
    assert rows["transport.tls"][1:3] == ["null", "path or null"]
    assert rows["high.min_size"][1] == "16" and rows["high.learning_rate"][3] == rows["low.learning_rate"][3]


def split_row(line):
    """Return the cells of a row as a reader sees them; nothing for another line."""
    text = html.unescape(re.sub(r"<[^>]*>", "", line)).replace("\\", "")
    cells = text.strip().removeprefix("|").removesuffix("|").split(" | ")
    return [cell.strip() for cell in cells] if line.startswith("| <") else []


def test_the_reference_names_every_command_and_its_options():
    page = reference.commands()
    assert [name for name in describe_commands() if f"\n## zsdist {name}\n" not in page] == []
    assert "<code>--single-process</code>" in page and "### zsdist scenes from-map" in page


def test_the_reference_of_python_has_docstrings_with_their_sections():
    page = reference.python()
    assert "### zsdist.load_policy\n" in page
    assert "### families.draw\n\n```python\nfrom zsdist.sim.scenes import families\n\nfamilies.draw(\n" in page
    assert "from zsdist.runtime.runner import BundleRunner\n\nBundleRunner(" in page
    assert "#### BundleRunner.decide" in page and "- `picture`: `(px, px, 3)` uint8" in page


def test_lists_and_code_are_written_as_the_generator_reads_them():
    text = "- one:\n\n      zsdist doctor\n\n      all is well\n  - two\nand\n| a |\n|---|\n"
    assert pages.plain_markdown("1. one:\n\n       zsdist doctor\n\n       all is well\n\n   more\n") == (
        "1. one:\n\n    ```bash\n    zsdist doctor\n    ```\n\n    ```text\n    all is well\n    ```\n\n    more\n"
    )
    assert pages.plain_markdown(text).startswith("- one:\n\n    ```bash\n    zsdist doctor\n    ```\n")


def test_links_lead_from_page_to_page_and_code_keeps_its_own(tmp_path):
    made = pages.Pages(tmp_path)
    text = "[a](../deploy/README.md#the-token) [b](../examples/drive_episode.py) [c](#here)\n\n    [d](e.md)\n"
    assert made.convert(text, ROOT / "docs" / "usage.md", "usage.md") == (
        "[a](deploy.md#the-token) [b](files/examples/drive_episode.py.md) [c](#here)\n\n```text\n[d](e.md)\n```\n"
    )
    assert pages.relative("a.md", "b/c.md") == "../a.md" and pages.relative("b/a.md", "b/c.md") == "a.md"


def test_no_line_ends_within_an_option(tmp_path):
    (tmp_path / "a.html").write_text("<p>a-b <code>zsdist launch --run-dir &lt;x-y&gt;</code></p>")
    build_site.keep_options_whole(tmp_path)
    whole = '<code>zsdist launch <span class="whole">--run-dir</span> &lt;x-y&gt;</code>'
    assert (tmp_path / "a.html").read_text() == f"<p>a-b {whole}</p>"


def test_a_site_with_a_dead_link_or_something_from_elsewhere_is_refused(tmp_path):
    (tmp_path / "a.html").write_text(
        '<a href="b.html#x">x</a><a href="c.html">c</a><a id="y" href="https://a.org">z</a>'
    )
    (tmp_path / "b.html").write_text('<script src="https://cdn.org/x.js"></script><a href="a.html#y">y</a>')
    (tmp_path / "x.css").write_text("@import url(https://fonts.org/x);")
    assert build_site.faults(tmp_path) == [
        "a.html: b.html#x has no such place",
        "a.html: c.html leads nowhere",
        "b.html loads https://cdn.org/x.js",
        "x.css loads from another machine",
    ]
