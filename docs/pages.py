"""Pages of the documentation site, made of the Markdown files of the checkout, whose links work on a code host."""

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parents[1]
ELSEWHERE = {  # documents outside of docs/, with the names of their pages
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "vulnerabilities.md",
    "CHANGELOG.md": "changelog.md",
    "deploy/README.md": "deploy.md",
}
PICTURES = {".png", ".jpg", ".webp", ".svg"}
LANGUAGES = {".py": "python", ".yaml": "yaml", ".yml": "yaml", ".cff": "yaml", ".sh": "bash", ".json": "json"}
_LINK = re.compile(r"(\]\()([^)\s#]*)(#[^)\s]*)?(\))")
_COMMAND = re.compile(
    r"(zsdist|python|pip|make|git|\.|source|mkdir|cd|ray|docker|kubectl|helm|ssh|rsync|sbatch|chmod|export|ros2|"
    r"deploy/\S+|\.runtime/\S+|PYTHONPATH=\S+|RAY_\w+=\S+|ZSDIST_\w+=\S+|HUB=\S+)(\s|$)"
)
_PARSER = MarkdownIt("commonmark").enable("table")


def documents() -> dict[Path, str]:
    """Return all documents with the names of their pages."""
    inside = {path: path.name for path in sorted((ROOT / "docs").glob("*.md"))}
    return inside | {ROOT / name: page for name, page in ELSEWHERE.items()}


@dataclass
class Pages:
    """Pages in a folder.

    Attributes:
        folder: folder of the pages.
        linked: files outside of docs/ that a page links to, with the pages that show them.
    """

    folder: Path
    linked: dict[Path, str] = field(default_factory=dict)

    def write(self) -> None:
        """Write all documents, their pictures, and the files that they link to."""
        for path, page in documents().items():
            self.put(page, self.convert(path.read_text(encoding="utf-8"), path, page))
        for path in sorted((ROOT / "docs").iterdir()):
            if path.suffix in PICTURES or path.name == "site.css":
                shutil.copy(path, self.folder / path.name)
        shown: set[Path] = set()
        while left := set(self.linked) - shown:  # a folder adds the files in it
            for path in sorted(left):
                self.put(self.linked[path], self._shown(path))
            shown |= left

    def put(self, page: str, text: str) -> None:
        """Write one page."""
        target = self.folder / page
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")

    def convert(self, text: str, path: Path, page: str) -> str:
        """Return a document as the site's generator reads it: its links lead to pages, its lists have four spaces."""
        return plain_markdown(rewritten(text, lambda target: self._page_of(path, target, page)))

    def _page_of(self, path: Path, target: str, page: str) -> str:
        """Return the target of a link on a page."""
        found = (path.parent / target).resolve()
        if found in documents():
            name = documents()[found]
        elif found.suffix in PICTURES and found.parent == ROOT / "docs":
            name = found.name
        else:
            name = self.linked.setdefault(found, f"files/{found.relative_to(ROOT)}.md")
        return relative(name, page)

    def _shown(self, path: Path) -> str:
        """Return the page of a file, or of a folder."""
        name = path.relative_to(ROOT).as_posix()
        if path.is_dir():
            files = [file for file in sorted(path.iterdir()) if file.is_file() and file.suffix in {*LANGUAGES, ".md"}]
            for file in files:
                self.linked.setdefault(file, f"files/{file.relative_to(ROOT)}.md")
            items = [f"- [`{file.name}`]({relative(self.linked[file], self.linked[path])})" for file in files]
            return "\n".join((f"# `{name}/`", "", *items, ""))
        text = path.read_text(encoding="utf-8")
        return f"# `{name}`\n\n````{LANGUAGES.get(path.suffix, 'text')}\n{text.rstrip()}\n````\n"


def relative(name: str, page: str) -> str:
    """Return the path of a page or a file as one of another page links to it."""
    here, there = PurePosixPath(page).parent.parts, PurePosixPath(name).parts
    common = next((i for i, (a, b) in enumerate(zip(here, there, strict=False)) if a != b), min(len(here), len(there)))
    return "/".join((*[".."] * (len(here) - common), *there[common:]))


def rewritten(text: str, page_of: Callable[[str], str]) -> str:
    """Return Markdown with the targets of its relative links replaced; code is left as it is."""
    lines = text.splitlines()
    code = {number for token in _PARSER.parse(text) if token.type in ("fence", "code_block") for number in _span(token)}

    def replaced(match: re.Match[str]) -> str:
        opening, target, anchor, closing = match.groups()
        if not target or "://" in target or target.startswith("mailto:"):
            return match.group()
        return f"{opening}{page_of(target)}{anchor or ''}{closing}"

    return "\n".join(line if i in code else _LINK.sub(replaced, line) for i, line in enumerate(lines)) + "\n"


def plain_markdown(text: str) -> str:
    """Return CommonMark as Python-Markdown reads it.

    That wants four spaces within items of lists, and an empty line before lists, tables and code. Indented code gets
    fences, so that it is coloured and can be copied.
    """
    lines = text.splitlines()
    tokens = _PARSER.parse(text)
    depth, indent = [0] * (len(lines) + 1), [0] * (len(lines) + 1)
    fenced: dict[int, int] = {}
    apart: set[int] = set()
    for token in tokens:
        if token.type == "list_item_open":
            first, *others = _span(token)
            width = len(re.match(r"\s*([-*+]|\d+[.)])\s+", lines[first]).group())  # type: ignore[union-attr]
            for number in others:
                depth[number] += 1
                indent[number] = width
        elif token.type == "code_block":
            fenced |= _blocks(lines, _span(token))
        if token.type in ("bullet_list_open", "ordered_list_open", "table_open", "fence") and token.map is not None:
            apart.add(token.map[0])
    made: list[str] = []
    end = -1
    for number, line in enumerate(lines):
        space = " " * 4 * depth[number]
        body = line[indent[number] :] if not line[: indent[number]].strip() else line.lstrip()
        if number in fenced:
            end = fenced[number]
            made.append(f"{space}```{_language(lines[number : end + 1])}")
        if number <= end:
            made.append((space + body[4:]).rstrip())
            if number == end:
                made.append(f"{space}```")
            continue
        if number in apart and made and made[-1].strip():
            made.append("")
        made.append((space + body).rstrip() if line.strip() else "")
    return "\n".join(made) + "\n"


def _blocks(lines: list[str], span: range) -> dict[int, int]:
    """Return first and last lines of indented code; what a command prints is apart from it."""
    starts = [n for n in span if lines[n].strip() and (n == span[0] or not lines[n - 1].strip())]
    kinds = [_language([lines[n]]) for n in starts]
    found: dict[int, int] = {}
    for begin, kind in zip(starts, kinds, strict=True):
        if not found or (kinds[0] == "bash" and kind == "text" and begin == starts[1]):
            found[begin] = begin
    ends = [*list(found)[1:], span.stop]
    return {
        begin: max(n for n in range(begin, end) if lines[n].strip()) for begin, end in zip(found, ends, strict=True)
    }


def _span(token: Token) -> range:
    return range(*(token.map or (0, 0)))


def _language(lines: list[str]) -> str:
    first = next(line.strip().removeprefix("$ ") for line in lines if line.strip())
    if re.match(r"(import|from) \w|env = |model = ", first):
        return "python"
    if re.match(r"version: \d", first):
        return "yaml"
    return "bash" if _COMMAND.match(first) and "success" not in first else "text"
