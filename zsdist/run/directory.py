"""The run directory: the files of a run, from which it is resumed. While it runs, only the scheduler writes them."""

import contextlib
import hashlib
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

from zsdist import __version__, config
from zsdist.common import atomic_files, json_lines
from zsdist.config import Config
from zsdist.errors import ConfigError, DecodeError, RunError
from zsdist.telemetry.snapshot import Fields
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire import codec
from zsdist.wire.messages import State

CHECKPOINTS_KEPT = 3
FILES_OF_A_START = ("config.yaml", "epochs", "endpoint", "metrics.jsonl")  # written before a run has done anything
FIXED = (  # settings that cannot change when a run is resumed, since its states depend on them
    "seed",
    "grid.cells",
    "grid.blocks",
    "grid.cell_size_m",
    "grid.arena_m",
    "high.hidden",
    "low.hidden",
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
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock(folder)
        check_new(folder)  # again: another process may have been faster
        for name in ("checkpoints", "figures", "logs"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        rewrite_config(folder, settings)
    except OSError as error:
        discard(folder)
        raise RunError(f"run directory {folder} cannot be written: {error.strerror}") from error
    return folder


def check_new(folder: Path) -> None:
    """Raise `RunError` where a folder cannot become a run directory, since it holds a run or is a file."""
    try:
        if (folder / "config.yaml").exists():
            raise RunError(f"run directory {folder} holds a run already; allowed are a new folder or --resume {folder}")
        if folder.exists() and not folder.is_dir():
            raise RunError(f"run directory {folder} is a file; allowed is a folder")
    except OSError as error:
        raise RunError(f"run directory {folder} cannot be written: {error.strerror}") from error


def discard(folder: Path) -> bool:
    """Remove the files of a run that has not begun, and the folder where nothing else is in it.

    Returns:
        False, and nothing is removed, where a role has written something: an episode, a checkpoint, or its log.
    """
    begun = [*folder.glob("checkpoints/*/manifest.json"), folder / "episodes.jsonl", *folder.glob("logs/*")]
    if any(path.exists() and path.stat().st_size for path in begun):
        return False
    for path in (*map(folder.joinpath, FILES_OF_A_START), *begun, *folder.glob("tensorboard/events.*")):
        path.unlink(missing_ok=True)
    shutil.rmtree(folder / "journal", ignore_errors=True)
    for path in (folder / "checkpoints", folder / "figures", folder / "logs", folder / "tensorboard", folder):
        with contextlib.suppress(OSError):  # it holds a file that is not of the run
            path.rmdir()
    return True


def check_is_run(folder: Path) -> None:
    """Raise `RunError` where a folder is no run directory."""
    if not (folder / "config.yaml").is_file():
        raise RunError(f"resume folder {folder} holds no run: there is no config.yaml in it")


def reopen(folder: Path, overrides: tuple[str, ...] = ()) -> tuple[Config, dict[str, State]]:
    """Return configuration (with overrides) and newest checkpoint of an earlier run; change nothing yet.

    A run that ended before its first checkpoint has no states, and begins anew.

    Raises:
        RunError: there is no run, or its checkpoint is damaged, or an override changes a fixed setting.
    """
    check_is_run(folder)
    try:
        original, settings = (config.load(folder / "config.yaml", changes) for changes in ((), overrides))
    except ConfigError as error:
        raise RunError(f"resume folder {folder}: {error}") from error
    for key in FIXED:
        before, now = (attrgetter(key)(config_tree) for config_tree in (original, settings))
        if before != now:
            raise RunError(f"resume folder {folder}: {key} is {now}; allowed is the run's original value, {before}")
    if not has_checkpoint(folder):
        return settings, {}
    newest = newest_checkpoint(folder)
    try:
        return settings, read_checkpoint(newest)
    except RunError as error:
        older = sorted(path.name for path in newest.parent.glob("[0-9]*") if path.name < newest.name)
        remedy = f"; remove {newest} to resume from {older[-1]}" if older else ""
        raise RunError(f"{error}{remedy}") from error


def ended(folder: Path) -> str | None:
    """Return how the last start of a run ended, from its summary; None if it ended without a summary."""
    try:
        return json.loads((folder / "summary.json").read_text())["ended"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{folder / 'summary.json'} is not a run's summary: {error!r}") from error


def rewind(folder: Path, settings: Config, states: dict[str, State]) -> None:
    """Make the folder of a resumed run agree with its checkpoint: prune all that came later.

    Journals are removed too. Each belongs to one start of the run, and episodes in them that finished after the
    checkpoint are driven again.
    """
    rewrite_config(folder, settings)
    shutil.rmtree(folder / "journal", ignore_errors=True)
    finished = set(states["scheduler"].meta["finished"]) if states else set()
    json_lines.prune(folder / "episodes.jsonl", lambda record: record["episode"] not in finished)
    json_lines.prune(folder / "metrics.jsonl", lambda row: row.get("episodes", 0) > len(finished))


def key_name(folder: Path) -> str:
    """Return the run's name on the key space: the folder's name with all characters replaced that no key may have."""
    return re.sub(r"[^A-Za-z0-9._-]", "-", folder.resolve().name)[:64] or "run"


def rewrite_config(folder: Path, settings: Config) -> None:
    """Write `config.yaml`: the resolved configuration, with the version that wrote it."""
    head = f"# zsdist {__version__}, seed {settings.seed}\n"
    atomic_files.replace(folder / "config.yaml", (head + config.dump(settings)).encode())


def has_checkpoint(folder: Path) -> bool:
    """Return whether a run directory holds a complete checkpoint."""
    return any(folder.glob("checkpoints/*/manifest.json"))


def newest_checkpoint(folder: Path) -> Path:
    """Return the newest checkpoint of a run directory; raise `RunError` where there is none."""
    found = sorted(folder.glob("checkpoints/*/manifest.json"))
    if not found:
        raise RunError(f"run directory {folder} holds no checkpoint to resume from")
    return found[-1].parent


def read_checkpoint(checkpoint: Path) -> dict[str, State]:
    """Return the states of all roles in a checkpoint folder, each checked against the manifest's hash.

    Raises:
        RunError: a file is missing or damaged.
    """
    try:
        manifest = json.loads((checkpoint / "manifest.json").read_text())
        states = {}
        for name, digest in manifest["sha256"].items():
            payload = (checkpoint / f"{name}.state").read_bytes()
            if hashlib.sha256(payload).hexdigest() != digest:
                raise RunError(
                    f"checkpoint file {checkpoint / name}.state is damaged: its SHA-256 is not the manifest's"
                )
            states[name] = codec.decode(payload, expect=State)
    except OSError as error:
        raise RunError(f"checkpoint {checkpoint}: {error.filename}: {error.strerror}") from error
    except (ValueError, KeyError, DecodeError) as error:
        raise RunError(f"checkpoint {checkpoint} is damaged: {error}") from error
    return states


def read_vision(checkpoint: Path) -> VisionIdentity:
    """Return the vision model that a checkpoint's policy was trained with; raise `RunError` where it names none."""
    path = checkpoint / "manifest.json"
    try:
        return VisionIdentity.from_json(json.loads(path.read_text())["vision"])
    except OSError as error:
        raise RunError(f"checkpoint {checkpoint}: {error.filename}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"checkpoint file {path} does not name the vision model of its policy: {error}") from error


def issue_epochs(folder: Path, count: int) -> range:
    """Return `count` new epochs, never issued before in this run directory (earlier starts included).

    The first is drawn at random, so that a frame of another run has an epoch that was never issued in this one.
    """
    path = folder / "epochs"
    with _written(folder):
        first = int(path.read_text()) if path.exists() else secrets.randbelow(2**31) * 2**20
        atomic_files.replace(path, str(first + count).encode())
    return range(first, first + count)


@contextlib.contextmanager
def _written(folder: Path) -> Iterator[None]:
    """Turn an error of the system into a `RunError` that names the run directory."""
    try:
        yield
    except OSError as error:
        raise RunError(f"run directory {folder} cannot be written: {error.strerror or error}") from error


class RunDirectory:
    """Files of a run, written by the scheduler (`zsdist.roles.scheduler.run_log.RunLog`)."""

    def __init__(self, folder: Path, vision: VisionIdentity, earlier_s: float = 0.0) -> None:
        """Open the files of `folder`.

        Args:
            folder: run directory.
            vision: vision model of the policy, which is written into checkpoints.
            earlier_s: real seconds that earlier starts of this run took.
        """
        from tensorboard.summary import Writer  # only the scheduler needs it; torch's own writer imports all of torch

        self.folder = folder
        self._vision = vision
        self._earlier_s = earlier_s
        self._opened_s = time.monotonic()
        with _written(folder):
            self._episodes = (folder / "episodes.jsonl").open("a", buffering=1)
            self._metrics = (folder / "metrics.jsonl").open("a", buffering=1)
            self._board = Writer(str(folder / "tensorboard"))

    def episode(self, record: dict[str, Any]) -> None:
        """Append one line to `episodes.jsonl`."""
        with _written(self.folder):
            self._episodes.write(json.dumps(record, allow_nan=False) + "\n")
            for name in ("return", "steps", "epsilon"):
                self._board.add_scalar(f"episode/{name}", record[name], record["finished_as"])

    def metrics(self, row: Fields) -> None:
        """Append one line to `metrics.jsonl`, and TensorBoard events over the env steps of finished episodes."""
        step = int(row.get("env_steps", 0))
        with _written(self.folder):
            self._metrics.write(json.dumps(row, allow_nan=False) + "\n")
            for name, value in row.items():
                if isinstance(value, int | float) and name != "time_s":
                    self._board.add_scalar(f"run/{name}", value, step)

    def checkpoint(self, episodes: int, states: dict[str, State]) -> None:
        """Write `checkpoints/{episodes}`, complete or not at all, and remove the oldest beyond those kept.

        Once this returns, the checkpoint survives a power failure, as far as the disk writes what it confirms.

        Raises:
            RunError: it cannot be written; the checkpoints before it stay.
        """
        payloads = {name: codec.encode(state) for name, state in states.items()}
        final = self.folder / "checkpoints" / f"{episodes:08d}"
        with _written(self.folder):
            try:
                self._write_checkpoint(final, episodes, payloads)
            except OSError:
                shutil.rmtree(final.with_name(f".{final.name}.partial"), ignore_errors=True)  # it may fill the disk
                raise

    def _write_checkpoint(self, final: Path, episodes: int, payloads: Mapping[str, bytes]) -> None:
        partial, aside = (final.with_name(f".{final.name}.{suffix}") for suffix in ("partial", "old"))
        for left_over in (partial, aside):  # left by a killed process
            shutil.rmtree(left_over, ignore_errors=True)
        partial.mkdir(parents=True)
        for name, payload in payloads.items():
            atomic_files.write(partial / f"{name}.state", payload)
        hashes = {name: hashlib.sha256(payload).hexdigest() for name, payload in payloads.items()}
        manifest = {
            "zsdist": __version__,
            "episodes": episodes,
            "vision": self._vision.to_json(),
            "sha256": hashes,
        }
        atomic_files.write(partial / "manifest.json", json.dumps(manifest, indent=1).encode())
        atomic_files.sync_folder(partial)
        if final.exists():  # after as many episodes; moved aside in one step, so that a kill leaves no part of it
            final.rename(aside)
        partial.rename(final)
        atomic_files.sync_folder(final.parent)
        shutil.rmtree(aside, ignore_errors=True)
        for old in sorted(final.parent.glob("[0-9]*"))[:-CHECKPOINTS_KEPT]:
            shutil.rmtree(old)

    def wall_s(self) -> float:
        """Return the real seconds that the run has taken so far, earlier starts included."""
        return round(self._earlier_s + time.monotonic() - self._opened_s, 3)

    def summary(self, fields: Mapping[str, Any]) -> None:
        """Write `summary.json`, and flush all files."""
        with _written(self.folder):
            atomic_files.replace(self.folder / "summary.json", json.dumps(fields, indent=1, allow_nan=False).encode())
            for file in (self._episodes, self._metrics):
                file.flush()
            self._board.flush()
