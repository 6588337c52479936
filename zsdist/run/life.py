"""Life of a run, as its folder shows it to others: starting, running, ended, or gone without a word."""

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zsdist import config
from zsdist.common import commands
from zsdist.errors import ConfigError, RunError
from zsdist.run import directory, location

SIGNS = ("config.yaml", "epochs", "endpoint", "metrics.jsonl", "episodes.jsonl", "summary.json")
ALIVE_WITHIN_S = 60.0  # a run that has not ended and wrote something within this time counts as running


@dataclass(frozen=True)
class RunLife:
    """State of a run at the time of reading.

    Attributes:
        folder: run directory.
        name: name of the run on the key space.
        started_s: unix time of its last start.
        seen_s: unix time at which it last wrote something.
        endpoint: endpoint of its hub; None: no hub was started yet.
        summary: content of `summary.json`; None: it has not ended.
    """

    folder: Path
    name: str
    started_s: float
    seen_s: float
    endpoint: str | None
    summary: dict[str, Any] | None

    @property
    def title(self) -> str:
        """Name of the run for people: that of its folder, whatever characters it has."""
        return self.folder.resolve().name

    @property
    def ended(self) -> bool:
        """True if it has ended and saved everything."""
        return self.summary is not None

    @property
    def runs(self) -> bool:
        """True if it seems to run."""
        return not self.ended and time.time() - self.seen_s < ALIVE_WITHIN_S

    def farewell(self) -> str:
        """Return one line about a run that has ended."""
        assert self.summary is not None, "only a run that has ended has a summary"
        how, episodes = self.summary.get("ended", "ended"), self.summary.get("episodes", "?")
        ended_s = _written_s(self.folder / "summary.json") or self.seen_s
        return (
            f"run {self.title} ended at {clock(ended_s)}: {how} after {episodes} episodes; "
            f"last seen at {clock(self.seen_s)}"
        )

    def loss(self) -> str:
        """Return one line about a run that is gone and has not ended, with the command that resumes it."""
        line = (
            f"run {self.title} was last seen at {clock(self.seen_s)} and has not ended: it was killed, or it cannot be "
            "reached from here"
        )
        if not any(self.folder.glob("checkpoints/*/manifest.json")):
            return f"{line}; it has no checkpoint to resume from"
        return f"{line}; if it was killed, resume it with {commands.module('zsdist.launch', '--resume', self.folder)}"

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
        RunError: the folder holds no run, or its summary is damaged.
    """
    started_s = _written_s(folder / "config.yaml")
    if started_s is None:
        raise RunError(f"{folder} holds no run: there is no config.yaml in it")
    try:
        endpoint = (folder / "endpoint").read_text(encoding="utf-8").strip() or None
    except OSError:  # not there yet
        endpoint = None
    try:
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        summary = None
    except (OSError, ValueError) as error:
        raise RunError(f"{folder / 'summary.json'} is not a run's summary: {error!r}") from error
    if summary is not None and not isinstance(summary, dict):
        raise RunError(f"{folder / 'summary.json'} is not a run's summary; allowed is a JSON object")
    seen_s = max(at for name in SIGNS if (at := _written_s(folder / name)) is not None)
    return RunLife(folder, directory.key_name(folder), started_s, seen_s, endpoint, summary)


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
    found = [read(path.parent) for path in sorted(runs.glob("*/config.yaml"))]
    if not found:
        raise RunError(f"no run was found in {runs}; start one, or name --runs DIR, or --connect ENDPOINT")
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
