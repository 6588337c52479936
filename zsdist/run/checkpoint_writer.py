"""Writing of a checkpoint, complete or not at all, and the choice of those that are kept."""

import hashlib
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zsdist.common import atomic_files
from zsdist.errors import DamagedError, RunError
from zsdist.run.checkpoint_files import MANIFEST, checkpoints, manifest_bytes, read_manifest

BEST = "best"  # stands for a checkpoint's number in a path: the one with the highest score


def write(final: Path, payloads: Mapping[str, bytes], about: Mapping[str, Any], before: list[Path]) -> None:
    """Write a checkpoint; a process that is killed meanwhile leaves a hidden folder, which is not believed.

    Args:
        final: folder of the checkpoint; a complete one there is replaced.
        payloads: encoded states by name of the role.
        about: entries of the manifest besides the hashes.
        before: files that have to be on the disk before the checkpoint counts.

    Raises:
        OSError: it cannot be written; what was written of it is removed.
    """
    partial, aside = (final.with_name(f".{final.name}.{suffix}") for suffix in ("partial", "old"))
    for left_over in (partial, aside):  # left by a killed process
        shutil.rmtree(left_over, ignore_errors=True)
    try:
        for file in before:
            atomic_files.sync(file)
        partial.mkdir(parents=True)
        for name, payload in payloads.items():
            atomic_files.write(partial / f"{name}.state", payload)
        hashes = {name: hashlib.sha256(payload).hexdigest() for name, payload in payloads.items()}
        atomic_files.write(partial / MANIFEST, manifest_bytes({**about, "sha256": hashes}))
        atomic_files.sync_folder(partial)
        if final.exists():  # after as many episodes; moved aside in one step, so that a kill leaves no part of it
            final.rename(aside)
        partial.rename(final)
        atomic_files.sync_folder(final.parent)
    except OSError:
        shutil.rmtree(partial, ignore_errors=True)  # it may fill the disk
        raise
    shutil.rmtree(aside, ignore_errors=True)


def rotate(folder: Path, kept: int) -> None:
    """Remove all checkpoints of a run directory but the newest ones and the best one.

    Args:
        folder: run directory.
        kept: number of the newest ones that stay.

    Raises:
        OSError: one cannot be removed.
    """
    best = find_best(folder)
    for old in checkpoints(folder)[:-kept]:
        if old != best:
            shutil.rmtree(old)


def find_best(folder: Path) -> Path | None:
    """Return the checkpoint whose merge had the highest score, the newest of equal ones; None: none has a score."""
    scored = [(score, path) for path in checkpoints(folder) if (score := _score(path)) is not None]
    return max(scored, key=lambda found: (found[0], int(found[1].name)))[1] if scored else None


def names_best(path: Path) -> bool:
    """Return whether a path is `checkpoints/best` of a run directory, which is no folder."""
    return path.name == BEST and path.parent.name == "checkpoints" and not path.exists()


def require_best(folder: Path) -> Path:
    """Return the best checkpoint of a run directory; raise `RunError` where none has a score."""
    best = find_best(folder)
    if best is None:
        raise RunError(f"no checkpoint in {folder} has a score, which a merge gives; allowed is the run directory")
    return best


def _score(checkpoint: Path) -> float | None:
    try:
        score = read_manifest(checkpoint).get("score")
    except DamagedError:  # damage is reported where a checkpoint is read to be used
        return None
    return float(score) if isinstance(score, int | float) else None
