"""Site of the documentation: makes the pages in build/docs, builds them, and checks every link of the result.

Usage: `python docs/build_site.py [FOLDER]`, from anywhere; `make docs` installs what it needs first.
"""

import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import reference
from pages import ROOT, Pages

LOADED = {"img": "src", "script": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}
_REMOTE_STYLE = re.compile(r"(?:@import|url\()\s*['\"]?(?:https?:)?//")

_CODE = re.compile(r"(?<=<code>)[^<\n]*(?=</code>)")
_HYPHENED = re.compile(r"(?<!\S)(?=\S*[-.])[\w./=-]{2,28}(?!\S)")


class Html(HTMLParser):
    """Links, what is loaded, and anchors of one page.

    Attributes:
        links: targets of links.
        loads: addresses of pictures, scripts and styles.
        anchors: names to which a link may lead.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors: set[str] = {"", "__comments"}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note one element."""
        found = dict(attrs)
        self.anchors |= {name for key in ("id", "name") if (name := found.get(key))}
        if tag == "a" and found.get("href"):
            self.links.append(found["href"] or "")
        address = found.get(LOADED.get(tag, ""))
        if address and found.get("rel") not in ("canonical", "next", "prev"):
            self.loads.append(address)


def make_pages(folder: Path) -> None:
    """Write pages and configuration of the site."""
    shutil.rmtree(folder, ignore_errors=True)
    pages = Pages(folder / "pages")
    pages.put("reference/settings.md", reference.settings())
    pages.put("reference/commands.md", reference.commands())
    pages.put("reference/python.md", reference.python())
    pages.write()
    shutil.copy(ROOT / "docs" / "mkdocs.yml", folder / "mkdocs.yml")


def keep_options_whole(site: Path) -> None:
    """Mark options and names of files in code between other text, so that no line ends within one of them."""
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        path.write_text(
            _CODE.sub(lambda found: _HYPHENED.sub(r'<span class="whole">\g<0></span>', found.group()), text),
            encoding="utf-8",
        )


def faults(site: Path) -> list[str]:
    """Return links that lead nowhere, and whatever a page would fetch from another machine."""
    found: list[str] = []
    pages = {path: Html(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        name = path.relative_to(site)
        found += [f"{name} loads {address}" for address in page.loads if re.match(r"(https?:)?//", address)]
        for link in sorted({*page.links, *page.loads}):
            parts = urlsplit(link)
            if parts.scheme in ("http", "https"):
                if "." not in parts.netloc and parts.hostname != "localhost":
                    found.append(f"{name}: {link} names no machine")
                continue
            if parts.scheme:  # mailto:, data:, javascript:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            if name.name == "404.html" and parts.path.startswith("/"):
                target = site / parts.path.lstrip("/")
            if not target.exists():
                found.append(f"{name}: {link} leads nowhere")
            elif target in pages and unquote(parts.fragment) not in pages[target].anchors:
                found.append(f"{name}: {link} has no such place")
    for path in sorted(site.rglob("*.css")):
        if _REMOTE_STYLE.search(path.read_text(encoding="utf-8")):
            found.append(f"{path.relative_to(site)} loads from another machine")
    return found


def main(folder: str = str(ROOT / "build" / "docs")) -> int:
    """Make, build and check the site; return 1 where something is wrong."""
    place = Path(folder)
    make_pages(place)
    command = [
        sys.executable,
        "-m",
        "zensical",
        "build",
        "--strict",
        "--clean",
        "--config-file",
        str(place / "mkdocs.yml"),
    ]
    if (status := subprocess.run(command, check=False).returncode) != 0:
        return status
    keep_options_whole(place / "site")
    wrong = faults(place / "site")
    for line in wrong:
        print(line, file=sys.stderr)
    print(f"{len(list((place / 'site').rglob('*.html')))} pages: {place / 'site' / 'index.html'}; with its search:")
    print(f"  python -m http.server --bind 127.0.0.1 --directory {place / 'site'}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
