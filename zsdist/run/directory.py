"""The run directory: the files of a run, from which it is resumed. While it runs, only the scheduler writes them."""

import contextlib
import json
import os
import re
import secrets
import shutil
import time
import weakref
from collections.abc import Callable, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

from zsdist import __version__, config
from zsdist.common import atomic_files, commands, folders, json_lines, locks, output_files
from zsdist.common.ownership import Owned
from zsdist.config import Config
from zsdist.errors import ConfigError, RunError
from zsdist.run import board, checkpoint_writer, figures_file, location
from zsdist.run.checkpoint_files import (
    checkpoints,
    has_checkpoint,
    newest_checkpoint,
    newest_whole,
    read_manifest,
    set_aside,
)
from zsdist.run.episodes_file import EpisodesFile
from zsdist.run.figures_file import FiguresFile, spacing
from zsdist.telemetry.snapshot import Fields
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire import codec
from zsdist.wire.messages import State

CHECKPOINTS_KEPT = 3
BOARD_DENSE = 100  # first rows of figures, and first episodes, that are all on the board; later ones ever further apart
BOARD_LEAST_OFTEN = 64  # rows of figures from one on the board to the next, at most
_FOLDERS = ("checkpoints", "figures", "logs")
FILES_OF_A_START = ("config.yaml", "epochs", "endpoint", "metrics.jsonl")  # written before a run has done anything
FIXED = (  # settings that cannot change when a run is resumed, since its states depend on them
    "seed",
    "grid.cells",
    "grid.blocks",
    "grid.cell_size_m",
    "grid.arena_m",
    "high.hidden",
    "low.hidden",
    "replay.start_from",  # a run starts once
)


def create(
    path: Path | None,
    settings: Config,
    root: Path = Path("runs"),
    lock: Callable[[Path], None] = lambda folder: None,
) -> Path:
    """Make the folder of a new run and write `config.yaml`.

    Args:
        path: folder to make; None: a folder under `root`, named by configuration and time.
        settings: resolved configuration.
        root: parent of unnamed runs.
        lock: called with the folder once it exists, before anything is written to it.

    Returns:
        The folder.

    Raises:
        RunError: `path` holds a run already, or cannot be made.
    """
    folder = path or root / f"{settings.run.name}-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}"
    check_new(folder)
    with output_files.made_folder(f"run directory {folder}", folder):
        lock(folder)
        check_new(folder)  # again: another process may have been faster
        try:
            _make_folders(folder)
            rewrite_config(folder, settings)
        except OSError:
            discard(folder)
            raise
    return folder


def check_new(folder: Path) -> None:
    """Raise `RunError` where a folder cannot become a run directory, since it holds a run or is a file."""
    try:
        str(folder.resolve()).encode()
    except UnicodeEncodeError as error:  # TensorBoard cannot write into such a folder
        raise RunError(f"run directory {folder} is no name in UTF-8; allowed is one in UTF-8") from error
    try:
        if (folder / "config.yaml").exists():
            raise RunError(
                f"run directory {folder} holds a run already; allowed are a new folder or "
                f"{commands.quoted('--resume', folder.absolute())}"
            )
        if folder.exists() and not folder.is_dir():
            raise RunError(f"run directory {folder} is a file; allowed is a folder")
    except OSError as error:
        raise RunError(f"run directory {folder} cannot be written: {error.strerror}") from error


def discard(folder: Path) -> bool:
    """Remove the files of a run that has not begun, and the folder where nothing else is in it.

    Returns:
        False, and nothing is removed, where a role has written something: an episode, a checkpoint, or its log.
    """
    begun = [
        *(checkpoint / "manifest.json" for checkpoint in checkpoints(folder)),
        folder / "episodes.jsonl",
        *folders.visible(folder, "logs/*"),
    ]
    if any(path.exists() and path.stat().st_size for path in begun):
        return False
    for path in (
        folder / locks.LOCK_FILE,
        *map(folder.joinpath, FILES_OF_A_START),
        *begun,
        *folders.visible(folder, "tensorboard/events.*"),
    ):
        path.unlink(missing_ok=True)
    shutil.rmtree(folder / "journal", ignore_errors=True)
    for path in (folder / "checkpoints", folder / "figures", folder / "logs", folder / "tensorboard", folder):
        with contextlib.suppress(OSError):  # it holds a file that is not of the run
            path.rmdir()
    return True


def check_is_run(folder: Path) -> None:
    """Raise `RunError` where a folder is no run directory."""
    if not (folder / "config.yaml").is_file():
        hint = location.suggest_run(folder)
        raise RunError(f"resume folder {folder} holds no run: there is no config.yaml in it{hint}")


def reopen(
    folder: Path, overrides: tuple[str, ...] = (), notify: config.Notify | None = None
) -> tuple[Config, dict[str, State]]:
    """Return configuration (with overrides) and newest whole checkpoint of an earlier run.

    Nothing is changed yet, except that damaged checkpoints are set aside. A run that ended before its first checkpoint
    has no states, and begins anew.

    Raises:
        RunError: there is no run, or all its checkpoints are damaged, or an override changes a fixed setting.
    """
    check_is_run(folder)
    try:
        original = config.load(folder / "config.yaml")
        settings = config.load_kept(folder / "config.yaml", overrides, notify)
    except ConfigError as error:
        raise RunError(f"resume folder {folder}: {error}") from error
    for key in FIXED:
        before, now = (attrgetter(key)(config_tree) for config_tree in (original, settings))
        if before != now:
            raise RunError(f"resume folder {folder}: {key} is {now}; allowed is the run's original value, {before}")
    if not has_checkpoint(folder):
        return settings, {}
    _, states, damaged = newest_whole(folder, notify)
    set_aside(damaged)  # from here on the newest one is whole
    # Checkpoints of earlier versions do not name the initial sizes that they began from.
    for key in ("size_initial", "batch_initial"):
        states["scheduler"].meta.get("sizing", {}).setdefault(key, getattr(original.replay, key))
    return settings, states


def write_summary(folder: Path, fields: Mapping[str, Any]) -> None:
    """Write `summary.json`, which says that a run has ended and when, also in a copy of the folder."""
    content = {**fields, "ended_unix_s": round(time.time(), 3)}
    with _written(folder):
        atomic_files.replace(folder / "summary.json", json.dumps(content, indent=1, allow_nan=False).encode())


def ended(folder: Path) -> str | None:
    """Return how the last start of a run ended, from its summary; None if it ended without a summary."""
    try:
        return json.loads((folder / "summary.json").read_text(encoding="utf-8"))["ended"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{folder / 'summary.json'} is not a run's summary: {error!r}") from error


def rewind(folder: Path, settings: Config, states: dict[str, State]) -> None:
    """Make the folder of a resumed run agree with its newest checkpoint: cut off all that came later.

    The work is in proportion to what came later. Journals are removed too: what they alone have is driven again.
    """
    rewrite_config(folder, settings)
    shutil.rmtree(folder / "journal", ignore_errors=True)
    finished = len(states["scheduler"].meta["finished"]) if states else 0
    json_lines.cut(folder / "episodes.jsonl", lambda record: record["finished_as"] <= finished)
    before = read_manifest(newest_checkpoint(folder)) if states else {"tensorboard": {}}
    figures_file.rewind(folder / "metrics.jsonl", finished, before.get("rows"))
    board.rewind(folder / "tensorboard", before.get("tensorboard"))
    _make_folders(folder)


def key_name(folder: Path) -> str:
    """Return the run's name on the key space: the folder's name with all characters replaced that no key may have."""
    return re.sub(r"[^A-Za-z0-9._-]", "-", folder.resolve().name)[:64] or "run"


def rewrite_config(folder: Path, settings: Config) -> None:
    """Write `config.yaml`: the resolved configuration, with the version that wrote it."""
    head = f"# zsdist {__version__}, seed {settings.seed}\n"
    atomic_files.replace(folder / "config.yaml", (head + config.dump(settings)).encode())


def issue_epochs(folder: Path, count: int) -> range:
    """Return `count` new epochs, never issued before in this run directory (earlier starts included).

    The first is drawn at random, so that a frame of another run has an epoch that was never issued in this one.
    """
    path = folder / "epochs"
    with _written(folder):
        first = int(path.read_text(encoding="utf-8")) if path.exists() else secrets.randbelow(2**31) * 2**20
        atomic_files.replace(path, str(first + count).encode())
    return range(first, first + count)


def _written(folder: Path) -> contextlib.AbstractContextManager[None]:
    return output_files.written(f"run directory {folder}")


class RunDirectory(Owned):
    """Files of a run, written by the scheduler (`zsdist.roles.scheduler.run_log.RunLog`).

    A run directory that is dropped is closed, and its lines are written.
    """

    def __init__(self, folder: Path, vision: VisionIdentity, kept: int = CHECKPOINTS_KEPT) -> None:
        """Open the files of `folder`.

        Args:
            folder: run directory.
            vision: vision model of the policy, which is written into checkpoints.
            kept: number of the newest checkpoints that are kept, besides the best one.
        """
        self.folder = folder
        self._vision = vision
        self._kept = kept
        self._opened_s = time.monotonic()
        with _written(folder):
            self._episodes = EpisodesFile(folder / "episodes.jsonl")
            self._figures = FiguresFile(folder / "metrics.jsonl")
            self._board = board.Board(folder / "tensorboard")
        self._close = weakref.finalize(self, _close, os.getpid(), self._episodes, self._figures, self._board)
        self._close.atexit = False

    def show_settings(self, settings: Config) -> None:
        """Show the configuration on TensorBoard, which can compare runs by it."""
        self.check_process()
        with _written(self.folder):
            self._board.add_settings(config.dump(settings), settings.model_dump(mode="json"))

    def episode(self, record: dict[str, Any]) -> None:
        """Append one line to `episodes.jsonl`, unless it is there already.

        The later in the run, the fewer episodes are shown on TensorBoard.
        """
        self.check_process()
        number = record["finished_as"]
        with _written(self.folder):
            if self._episodes.append(record) and number % spacing(number, BOARD_DENSE) == 0:
                self._board.add(number, {f"episode/{name}": record[name] for name in ("return", "steps", "epsilon")})

    def metrics(self, row: Fields) -> None:
        """Append one line to `metrics.jsonl`, and TensorBoard events over the env steps of finished episodes.

        Old lines are thinned out (`FiguresFile`). The later in the run, the fewer lines are shown on TensorBoard.
        """
        self.check_process()
        with _written(self.folder):
            number = self._figures.append(row)
            if number % min(spacing(number, BOARD_DENSE), BOARD_LEAST_OFTEN) == 0:
                shown = {board.tag(name): value for name, value in row.items() if name not in ("time_s", "stage")}
                step = int(row.get("env_steps", 0))
                self._board.add(step, {name: value for name, value in shown.items() if isinstance(value, int | float)})

    def checkpoint(self, episodes: int, states: Mapping[str, State | bytes], score: float | None = None) -> None:
        """Write a checkpoint, as the function that `begin_checkpoint` returns does."""
        self.begin_checkpoint(episodes, states, score)()

    def begin_checkpoint(
        self, episodes: int, states: Mapping[str, State | bytes], score: float | None = None
    ) -> Callable[[], None]:
        """Return a function that writes `checkpoints/{episodes}`, complete or not at all, and removes old ones.

        It may run on another thread while this object is used. Once it returns, the checkpoint survives a power
        failure, as far as the disk writes what it confirms, and so do all lines that were written before this call.
        It raises `RunError` where the checkpoint cannot be written; those before it stay.

        Args:
            episodes: count of finished episodes.
            states: states by name of the role; one in bytes is encoded already.
            score: score of the network that won the newest merge; None: there has been none.
        """
        final = self.folder / "checkpoints" / f"{episodes:08d}"
        events = board.sizes(self.folder / "tensorboard")
        about: dict[str, Any] = {
            "zsdist": __version__,
            "episodes": episodes,
            "vision": self._vision.to_json(),
            "rows": self._figures.rows,
            "tensorboard": events,
            **({} if score is None else {"score": score}),
        }
        lines = [self.folder / name for name in ("episodes.jsonl", "metrics.jsonl")]

        def write() -> None:
            payloads = {name: codec.encode(own) if isinstance(own, State) else own for name, own in states.items()}
            before = [*lines, *(self.folder / "tensorboard" / name for name in events)]
            with _written(self.folder):
                checkpoint_writer.write(final, payloads, about, before)
                checkpoint_writer.rotate(self.folder, self._kept)

        return write

    def wall_s(self) -> float:
        """Return the real seconds since the files were opened."""
        return time.monotonic() - self._opened_s

    def summary(self, fields: Mapping[str, Any]) -> None:
        """Write `summary.json`, after all other files are on the disk."""
        with _written(self.folder):
            self._sync()
        write_summary(self.folder, fields)

    def _sync(self) -> None:
        """Return once all lines and events are on the disk."""
        self._episodes.sync()
        self._figures.sync()
        self._board.sync()

    def close(self) -> None:
        """Close all files; closing again does nothing."""
        self._close()


def _close(process: int, *files: Any) -> None:
    """Close files, except in a forked process, which shares them with the process that opened them."""
    if os.getpid() == process:
        for file in files:
            with contextlib.suppress(OSError):  # a line that a full disk does not take was reported when it was written
                file.close()


def _make_folders(folder: Path) -> None:
    """Make the folders of a run directory; copies of it may lack those that were empty."""
    for name in _FOLDERS:
        (folder / name).mkdir(parents=True, exist_ok=True)
