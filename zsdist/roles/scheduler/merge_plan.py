"""Counts of finished episodes at which the merges of a run are due, and how far training goes beside them."""

from zsdist.config import Config
from zsdist.roles.scheduler.merge import next_merge_at
from zsdist.roles.scheduler.progress import RunProgress


class MergePlan:
    """Merge under way and those that are still to come, as they follow from the progress of a run.

    Args:
        config: configuration of the run.
        progress: progress of the run.
    """

    def __init__(self, config: Config, progress: RunProgress) -> None:
        self._every, self._target = config.merge.every_episodes, config.run.episodes
        self._progress = progress

    @property
    def next_merge(self) -> int:
        """Count of finished episodes at which the next merge is due, apart from one under way."""
        merge, merges = self._progress.merge, self._progress.totals.merges
        due = self._after(merge.episode if merge is not None else merges[-1]["episode"] if merges else 0)
        while (following := self._after(due)) <= self._progress.finished:  # as where merges were switched on since
            due = following
        return due

    @property
    def training_ends(self) -> int:
        """Number of episodes that may be finished or granted before the merge under way, or the next one, has ended.

        Training goes on beside a merge, but not past the merge that follows it.
        """
        return self.next_merge if self._progress.merge is not None else self._after(self.next_merge)

    @property
    def driven(self) -> int:
        """Number of drives of the merge under way; 0 without one."""
        return self._progress.merge.drives if self._progress.merge is not None else 0

    def _after(self, last: int) -> int:
        return next_merge_at(last, self._every, self._target)
