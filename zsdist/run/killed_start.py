"""Start of a run whose launcher was killed: the next start goes on with its journals, and loses nothing acknowledged.

Each role then recovers as the successor of one that died alone: the scheduler from its ledger, the replay from its
journals, a learner from the state that it kept. Only the actors begin anew, with the episodes that they had not ended.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from zsdist import config
from zsdist.common import folders
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.roles.replay import shards
from zsdist.roles.scheduler import ledger
from zsdist.roles.scheduler.progress import RunProgress, Stage
from zsdist.run import directory, journals, placement
from zsdist.run.program import RoleSpec
from zsdist.types import Level

_LEDGER = "journal/*-scheduler"


class KilledStart(NamedTuple):
    """Start of a run that has not ended.

    Attributes:
        word: word for this start of the run, part of the names of its journals.
        finished: count of finished episodes.
    """

    word: str
    finished: int


def has_ledger(folder: Path) -> bool:
    """Return whether the last start of a run has left a ledger: it has not ended."""
    return bool(folders.visible(folder, _LEDGER))


def find(folder: Path, settings: Config, notify: Callable[[str], None]) -> KilledStart | None:
    """Return the last start of a run if it was killed and all that the next start needs is there.

    Args:
        folder: run directory, before it is changed.
        settings: configuration of the next start.
        notify: called with the reason for the user if a killed start is there and cannot be gone on with.

    Returns:
        The killed start; None: the run has to be resumed from a checkpoint.

    Raises:
        RunError: the directory cannot be read.
    """
    for found in folders.visible(folder, _LEDGER):
        word = found.name.removesuffix("-scheduler")
        try:
            content = ledger.read(found)
            if content is None:
                continue  # it was killed before it had accepted anything
            progress = RunProgress(settings, 0, lambda reason: None)
            progress.recover(content)
            if progress.stage is Stage.DONE:
                continue  # the last checkpoint has everything
            _check_whole(folder, word, settings)
        except RunError as error:
            notify(f"{error}; so the run is resumed from its last checkpoint, and drives again what came after it")
            continue
        return KilledStart(word, progress.finished)
    return None


def _check_whole(folder: Path, word: str, settings: Config) -> None:
    """Raise `RunError` where the replay's journals are not complete, or do not fit the configuration."""
    written = config.load(folder / "config.yaml")
    before, now = (tree.replay.model_copy(update={"fsync_ms": None}) for tree in (written, settings))
    if before != now:
        raise RunError("settings of the replay have changed, with which its journals cannot be read")
    if settings.run.address is not None and not placement.lives_here(RoleSpec(shards.ROLE, "0", 0), settings):
        raise RunError("the replay's journals are on other machines")
    for index in range(settings.replay.shards):
        for level in Level:
            journal = journals.of_shard(settings, directory.key_name(folder), folder, word, index) / level
            if not (folders.visible(journal, "*.base") or folders.visible(journal, "*.copy")):
                raise RunError(f"the replay's journal {journal} is missing")
