"""Commands in the documents: where they stand, and the words that a shell would pass to them."""

import re
import shlex
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCUMENTS = (
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "deploy").glob("*.md")),
)
NUMBERS = {"N": "1", "S": "1"}  # placeholders of numbers; all others are texts
_BLOCK = re.compile(r"^ {4,}(?:\$ )?((?:zsdist|python -m zsdist)[ .](?:\\\n|.)*)", re.MULTILINE)
_CELL = re.compile(r"^\| `((?:zsdist|python -m zsdist)[ .][^`]*)` \|", re.MULTILINE)
_INLINE = re.compile(r"`((?:zsdist|python -m zsdist)[ .][^`]*)`")


@dataclass(frozen=True)
class Documented:
    """Command in a document: its name, the words behind it, and whether it stands in a line or a cell of its own."""

    document: str
    name: str
    words: tuple[str, ...]
    block: bool

    def __str__(self) -> str:
        return " ".join((self.document, self.name, *self.words))


def tutorial(folder: Path) -> Iterator[tuple[Documented, list[str]]]:
    """Yield the commands of the tutorial in order, with the lines that it shows as printed; make its files meanwhile.

    Args:
        folder: folder in which its reader works.
    """
    text = (ROOT / "docs" / "tutorial.md").read_text()
    scene = folder / "my-scenes" / "gate.yaml"
    scene.parent.mkdir()
    scene.write_text(textwrap.dedent(re.search(r"^    version: 1\n(?:    .*\n)+", text, re.MULTILINE).group()))
    made = {" ".join((command.name, *command.words)): command for command in commands()}
    blocks = re.findall(r"^(?: {4}.*\n)+", text, re.MULTILINE)
    for block, shown in pairwise([*blocks, ""]):
        words = shlex.split(block.replace("\\\n", " "))
        if words[0] == "zsdist":
            yield made[" ".join(words[1:])], [] if shown.startswith("    zsdist") else shown.splitlines()
        if "no way" in block:  # the reader is told to move a wall, and to check again
            before, after = re.search(r"replace `(.*?)` by `(.*?)`", text).groups()
            scene.write_text(scene.read_text().replace(before, after))
            again = blocks[blocks.index(block) + 1]
            yield made["scenes check my-scenes --out check.png"], again.splitlines()


def commands() -> list[Documented]:
    """Return the commands of all documents, each once a document. A word in prose, such as an option, is none."""
    found = {}
    for path in DOCUMENTS:
        text = path.read_text()
        lines = [(line, True) for line in (*_BLOCK.findall(text), *_CELL.findall(text))]
        lines += [(" ".join(line.split()), False) for line in _INLINE.findall(text)]
        for line, block in lines:
            line = re.sub(r"\$\(.*?\)|\$HUB", "tls/h:7447", line.replace("\\\n", " "))
            words = shlex.split(line, comments=True)
            words = words[2:] if words[0] == "python" else words[1:]
            if not words:
                continue
            end = next((index for index, word in enumerate(words) if word in ("|", "&&", ">", "&", ";")), len(words))
            name, *rest = (words[0].removeprefix("zsdist."), *words[1:end])
            if block or len(rest) > 1:
                words = tuple(NUMBERS.get(word, word) for word in rest if word != "...")
                made = Documented(str(path.relative_to(ROOT)), name, words, block)
                found.setdefault(str(made), made)
    return list(found.values())
