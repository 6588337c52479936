"""Life of a run, as its folder shows it to others: starting, running, ended, or gone without a word."""

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zsdist import config
from zsdist.common import commands, folders, locks
from zsdist.errors import ConfigError, RunError
from zsdist.run import checkpoint_files, directory, killed_start, location

SIGNS = ("config.yaml", "epochs", "endpoint", "metrics.jsonl", "episodes.jsonl", "summary.json")
ALIVE_WITHIN_S = 60.0  # where locks cannot be read, a run that wrote something within this time counts as running


@dataclass(frozen=True)
class RunLife:
    """State of a run at the time of reading.

    Attributes:
        folder: run directory.
        name: name of the run on the key space.
        started_s: unix time of its last start.
        seen_s: unix time at which it last wrote something.
        endpoint: endpoint of its hub; None: no hub was started yet.
        ended: whether it has ended and saved everything.
    """

    folder: Path
    name: str
    started_s: float
    seen_s: float
    endpoint: str | None
    ended: bool

    @property
    def title(self) -> str:
        """Name of the run for people: that of its folder, whatever characters it has."""
        return self.folder.resolve().name

    @property
    def killed(self) -> bool:
        """True if its launcher has left its lock and has not ended the run."""
        return not self.ended and locks.is_held(self.folder) is False

    @property
    def runs(self) -> bool:
        """True if it seems to run."""
        if self.ended:
            return False
        held = locks.is_held(self.folder)  # by its launcher
        return time.time() - self.seen_s < ALIVE_WITHIN_S if held is None else held

    def farewell(self) -> str:
        """Return one line about a run that has ended; raise `RunError` where its summary is damaged."""
        summary = self.summary()
        how, episodes = summary.get("ended", "ended"), summary.get("episodes", "?")
        at = self._last_seen(summary)
        return f"run {self.title} ended at {at}: {how} after {episodes} episodes; last seen at {at}"

    def loss(self) -> str:
        """Return one line about a run that is gone and has not ended, with the command that resumes it."""
        line = (
            f"run {self.title} was last seen at {clock(self.seen_s)} and has not ended: it was killed, or it cannot be "
            "reached from here"
        )
        has_state = checkpoint_files.has_checkpoint(self.folder) or killed_start.has_ledger(self.folder)
        how = "resume it" if has_state else "it has no checkpoint yet and begins anew"
        return f"{line}; if it was killed, {how} with {commands.module('zsdist.launch', '--resume', self.folder)}"

    def summary(self) -> dict[str, Any]:
        """Return the content of `summary.json`.

        Raises:
            RunError: it is damaged.
        """
        path = self.folder / "summary.json"
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise RunError(f"{path} is not a run's summary: {error!r}") from error
        if not isinstance(content, dict):
            raise RunError(f"{path} is not a run's summary; allowed is a JSON object")
        return content

    def fields(self) -> dict[str, Any]:
        """Return the fields of `zsdist.monitor --once --json` for a run that is not alive: `ended` is its summary.

        It is None where the run was killed.

        Raises:
            RunError: its summary is damaged.
        """
        summary = self.summary() if self.ended else None
        return {
            "run": self.name,
            "ended": summary,
            "last_seen": self._last_seen(summary or {}),
            "alive": [],
            "figures": {},
            "roles": {},
        }

    def _last_seen(self, summary: dict[str, Any]) -> str:
        """Return when it ended, from its summary, or else when it last wrote something."""
        noted = summary.get("ended_unix_s")  # earlier versions did not note it; files of a copy have the copy's time
        return clock(noted if isinstance(noted, int | float) else self.seen_s)

    def settings(self) -> config.Config:
        """Return its configuration.

        Raises:
            RunError: it cannot be read.
        """
        try:
            return config.load(self.folder / "config.yaml")
        except ConfigError as error:
            raise RunError(f"run directory {self.folder}: {error}") from error


def clock(unix_s: float) -> str:
    """Return local date and time."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(unix_s))


def read(folder: Path) -> RunLife:
    """Return the life of the run in a folder.

    Raises:
        RunError: the folder holds no run.
    """
    started_s = _written_s(folder / "config.yaml")
    if started_s is None:
        raise RunError(f"{folder} holds no run: there is no config.yaml in it")
    try:
        endpoint = (folder / "endpoint").read_text(encoding="utf-8").strip() or None
    except OSError:  # not there yet
        endpoint = None
    seen_s = max(at for name in SIGNS if (at := _written_s(folder / name)) is not None)
    return RunLife(folder, directory.key_name(folder), started_s, seen_s, endpoint, (folder / "summary.json").exists())


def find(runs: Path, name: str | None = None) -> RunLife:
    """Return the run of a name, or the newest one: of those that run the last started, else the last started of all.

    Args:
        runs: folder of run directories, or one of them.
        name: name of a run, or path of its folder or of something in it; None: the newest.

    Raises:
        RunError: there is none.
    """
    for place in (runs, *(() if name is None else (location.find_run(Path(name)),))):
        if (place / location.CONFIG_FILE).is_file():
            return read(place)
    found = [read(path.parent) for path in folders.visible(runs, "*/config.yaml")]
    if not found:
        called = "" if name is None else f" that is called {name!r}"
        raise RunError(f"no run{called} was found in {runs}; start one, or name --runs DIR, or --connect ENDPOINT")
    if name is None:
        return max(found, key=lambda life: (life.runs, life.started_s))
    named = [life for life in found if name in (life.name, life.folder.name)]
    if not named:
        raise RunError(f"no run in {runs} is called {name!r}; allowed are {_names(found)}")
    return named[-1]


def _names(found: Sequence[RunLife]) -> str:
    newest = sorted(found, key=lambda life: -life.started_s)
    return ", ".join(life.title for life in newest[:10]) + (", ..." if len(newest) > 10 else "")


def _written_s(path: Path) -> float | None:
    try:
        return path.stat().st_mtime
    except OSError:
        return None
