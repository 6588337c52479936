"""Folders of the journals of a run: in its directory, or on disks of their own. Each start of the run has its own."""

import hashlib
import shutil
from pathlib import Path

from zsdist.common import folders
from zsdist.config import Config
from zsdist.errors import RunError


def ledger(folder: Path, start: str) -> Path:
    """Return the folder of the scheduler's ledger, in the run directory `folder`, for one start of the run."""
    return folder / "journal" / f"{start}-scheduler"


def of_shard(config: Config, run: str, folder: Path, start: str, index: int) -> Path:
    """Return the folder of the journals of a shard of the replay, on the machine where the shard lives.

    Args:
        config: configuration of the run; `replay.journals` are given to the shards in turn.
        run: name of the run on the key space.
        folder: run directory.
        start: word for this start of the run.
        index: number of the shard.
    """
    if not config.replay.journals:
        return folder / "journal" / f"{start}-{index}"
    which = hashlib.sha256(str(folder).encode()).hexdigest()[:8]  # runs of one name in other folders have others
    return Path(config.replay.journals[index % len(config.replay.journals)]) / f"{run}-{which}-{start}-{index}"


def begin(config: Config, run: str, folder: Path, start: str, index: int, *, has_predecessor: bool = False) -> Path:
    """Return what `of_shard` returns, for the shard; on a disk of its own, those of earlier starts are removed.

    Raises:
        RunError: the shard has a predecessor in this start of the run, and the journal on that disk is not there: it is
            another disk, and what the predecessor has acknowledged would be lost in silence.
    """
    own = of_shard(config, run, folder, start, index)
    if config.replay.journals:
        if has_predecessor and not own.is_dir():
            raise RunError(f"its journal {own} is not there; this machine or its disk is not the one it was written on")
        for old in folders.visible(own.parent, own.name.replace(start, "*")):
            if old != own:
                shutil.rmtree(old, ignore_errors=True)
    return own
