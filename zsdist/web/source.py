"""Source of what the page shows: the runs of a folder, or the run at a hub."""

import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from zsdist.common import folders
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.run import life as lives
from zsdist.run.life import RunLife
from zsdist.telemetry import history, watching
from zsdist.transport.base import Transport
from zsdist.web.attention import Attention
from zsdist.web.live import LiveRun

MOST_LISTED = 50  # newest runs of a folder
MOST_LIVE = 8  # runs that are watched at a time
READ_AGAIN_S = 2.0

Connect = Callable[[RunLife | None], tuple[str, Transport]]


class RunsSource:
    """Runs of a folder, of which the page chooses; or one run at a hub.

    Args:
        connect: returns the name of a run and a connection to its hub; None stands for the run at the hub that an
            option of the command names.
        folder: folder of the runs, or one of them.
        run: name of the run that is shown first; None: the newest.
        hub: endpoint that an option names, which is then the only run; empty: the runs are those of the folder.
    """

    def __init__(self, connect: Connect, folder: Path, run: str | None, hub: str = "") -> None:
        self._connect, self._folder, self._run, self._hub = connect, folder, run, hub
        self._lock = threading.Lock()
        self._live: dict[str, LiveRun] = {}
        self._listed: list[RunLife] = []
        self._listed_s = -READ_AGAIN_S

    def runs(self) -> dict[str, Any]:
        """Return the runs with what their folders show, newest first, and the name of the one to show first."""
        if self._hub:
            title = self._run or self._hub
            return {"first": title, "runs": [{"name": title, "state": "running", "started_s": None}], "told": ""}
        listed = self._lives()
        found = [{"name": life.title, "state": _state_of(life), "started_s": life.started_s} for life in listed]
        try:
            first, told = lives.find(self._folder, self._run).title, ""
        except RunError as error:
            first, told = "", str(error)
        return {"first": first, "runs": found, "told": told}

    def live(self, run: str, car: str) -> bytes:
        """Return the state of a run now, and of a car that is looked at closely, as JSON."""
        return self._live_run(run).look(car)

    def compare(self, runs: list[str]) -> dict[str, Any]:
        """Return curves of several runs, and the settings in which they differ."""
        found = [] if self._hub else [life for name in runs for life in self._lives() if life.title == name]
        return {
            "runs": [{"name": life.title, "curves": history.curves(life.folder)} for life in found],
            "differences": history.differences([life.folder for life in found]) if len(found) > 1 else {},
        }

    def snapshot(self, run: str) -> dict[str, Any]:
        """Return what `zsdist.monitor --once --json` prints."""
        if not self._hub:
            life = self._find(run)
            if life.ended or life.killed:
                return life.fields()
        return self._live_run(run).snapshot(watching.FIRST_REPORT_WITHIN_S)

    def _lives(self) -> list[RunLife]:
        with self._lock:
            if time.monotonic() - self._listed_s >= READ_AGAIN_S:
                self._listed, self._listed_s = _read_lives(self._folder), time.monotonic()
            return self._listed

    def _find(self, name: str) -> RunLife:
        """Return a run of the folder; only those that are listed may be named from outside."""
        if not name:
            return lives.find(self._folder, self._run)
        life = next((life for life in self._lives() if life.title == name), None)
        if life is None:
            raise RunError(f"no run in {self._folder} is called {name[:80]!r}")
        return lives.read(life.folder)

    def _live_run(self, name: str) -> LiveRun:
        title = (self._run or self._hub) if self._hub else name
        if title not in self._live:
            title = title if self._hub else self._find(name).title
        with self._lock:
            if title not in self._live:
                if len(self._live) >= MOST_LIVE:
                    self._live = {key: live for key, live in self._live.items() if live.watched}
                if len(self._live) >= MOST_LIVE:
                    raise RunError(f"{MOST_LIVE} runs are being watched; close a page of another one")
                attention = Attention(partial(self._settings, title))
                self._live[title] = LiveRun(title, partial(self._open, title), attention)
            return self._live[title]

    def _open(self, title: str) -> tuple[str, Transport]:
        return self._connect(None if self._hub else self._find(title))

    def _settings(self, title: str) -> Config:
        if self._hub:
            raise RunError("attention needs the configuration of the run, which is in its folder; name --runs DIR")
        return self._find(title).settings()


def _read_lives(folder: Path) -> list[RunLife]:
    places = [folder]
    if not (folder / "config.yaml").is_file():
        places = [file.parent for file in folders.visible(folder, "*/config.yaml")]
    found = sorted((lives.read(place) for place in places), key=lambda life: -life.started_s)
    return found[:MOST_LISTED]


def _state_of(life: RunLife) -> str:
    if life.ended:
        return "ended"
    if life.runs:
        return "running" if life.endpoint is not None else "starting"
    return "lost"
