"""Server of the live view: the page's files, and what it asks for, as JSON. It only reads, and only for this machine.

A page of another site that has made its name point to this machine (DNS rebinding) is refused by the name in its
requests, and a page of another site that asks from within a browser by `Sec-Fetch-Site`.
"""

import json
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol
from urllib.parse import parse_qs, urlsplit

from zsdist.common import folders
from zsdist.common.http_address import HttpAddress
from zsdist.errors import RunError, ZsdistError

HOSTS = ("127.0.0.1", "localhost", "[::1]")  # names under which a browser on this machine, or at a tunnel's end, asks
KINDS = {
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "svg": "image/svg+xml",
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
MOST_RUNS = 8  # that are compared at a time
IDLE_AFTER_S = 30.0  # a connection without a request is closed


class PageSource(Protocol):
    """Source of what the page shows."""

    def runs(self) -> dict[str, Any]:
        """Return the runs that there are."""

    def live(self, run: str, car: str) -> bytes:
        """Return the state of a run now, and of a car that is looked at closely, as JSON."""

    def compare(self, runs: list[str]) -> dict[str, Any]:
        """Return curves of several runs, and the settings in which they differ."""

    def snapshot(self, run: str) -> dict[str, Any]:
        """Return what `zsdist.monitor --once --json` prints."""


class WebServer:
    """Server of the live view, as a context manager, on threads of its own.

    Args:
        where: address to listen at; port 0 is any free one.
        source: what is shown.

    Raises:
        RunError: it cannot listen there.

    Attributes:
        where: address at which it listens.
    """

    def __init__(self, where: HttpAddress, source: PageSource) -> None:
        try:
            self._server = _Server((where.host, where.port), _Handler)
        except OSError as error:
            raise RunError(
                f"the live view cannot be served at {where.url('')}: {error.strerror}; allowed is a free port, "
                "as in --web 8091"
            ) from error
        self.where = HttpAddress(where.host, self._server.server_port)
        self._server.source = source
        self._thread = threading.Thread(target=self._server.serve_forever, name="web", daemon=True)

    def __enter__(self) -> "WebServer":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads, block_on_close = True, False
    source: PageSource


class _Handler(BaseHTTPRequestHandler):
    protocol_version, server_version, sys_version = "HTTP/1.1", "zsdist", ""
    timeout = IDLE_AFTER_S
    server: _Server

    def do_GET(self) -> None:
        """Answer with a file of the page, or with JSON."""
        if not self._is_from_here():
            self._say(HTTPStatus.FORBIDDEN, f"this server answers browsers that ask for {', '.join(HOSTS)} only")
            return
        parts = urlsplit(self.path)
        asked = parse_qs(parts.query)
        answer = self._answers().get(parts.path)
        if answer is None:
            self._send_file(parts.path.removeprefix("/") or "index.html")
            return
        try:
            content = answer(asked)
        except ZsdistError as error:
            self._send(HTTPStatus.SERVICE_UNAVAILABLE, KINDS_JSON, _json({"error": str(error)}))
        else:
            self._send(HTTPStatus.OK, KINDS_JSON, content)

    do_HEAD = do_GET  # noqa: N815 - the name that http.server looks for

    def log_message(self, format: str, *words: object) -> None:
        """Write no log: the terminal is for people."""

    def _answers(self) -> dict[str, Callable[[dict[str, list[str]]], bytes]]:
        source = self.server.source
        return {
            "/runs.json": lambda asked: _json(source.runs()),
            "/live.json": lambda asked: source.live(_one(asked, "run"), _one(asked, "car")),
            "/compare.json": lambda asked: _json(source.compare(asked.get("run", [])[:MOST_RUNS])),
            "/snapshot.json": lambda asked: _json(source.snapshot(_one(asked, "run"))),
        }

    def _is_from_here(self) -> bool:
        host = self.headers.get("Host", "")
        name = host.rpartition(":")[0] if host.rpartition(":")[2].isdecimal() else host
        site = self.headers.get("Sec-Fetch-Site", "none")
        navigates = self.headers.get("Sec-Fetch-Mode") == "navigate"  # a link to the page may be anywhere
        return name.lower() in HOSTS and (site in ("none", "same-origin") or navigates)

    def _send_file(self, name: str) -> None:
        file = _FILES.get(name)
        if file is None:
            self._say(HTTPStatus.NOT_FOUND, "there is no such page")
        else:
            self._send(HTTPStatus.OK, *file)

    def _say(self, status: HTTPStatus, text: str) -> None:
        self._send(status, "text/plain; charset=utf-8", f"{text}\n".encode())

    def _send(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)


KINDS_JSON = "application/json"


def _json(content: dict[str, Any]) -> bytes:
    return json.dumps(content, allow_nan=False, separators=(",", ":")).encode()


def _one(asked: dict[str, list[str]], name: str) -> str:
    return asked.get(name, [""])[0]


def _read_files() -> dict[str, tuple[str, bytes]]:
    """Return the files of the page with their kinds, by name."""
    found = {}
    for file in folders.visible(Path(__file__).parent / "assets"):
        kind = KINDS.get(file.name.rpartition(".")[2])
        if kind is not None:
            found[file.name] = kind, file.read_bytes()
    return found


_FILES = _read_files()
