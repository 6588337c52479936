"""Times at which a journal is forced onto the disk, once for all records since the last time."""


class GroupSync:
    """Schedule of the syncs of one journal.

    Args:
        every_ms: shortest time between two syncs, which acknowledgements wait for; None: no syncs.
    """

    def __init__(self, every_ms: int | None) -> None:
        self._every_s = None if every_ms is None else every_ms / 1000
        self._next_s = 0.0
        self._waiting = False  # records have been written since the last sync

    @property
    def acknowledges_at(self) -> float:
        """Time from which on frames may be acknowledged: that of the next sync, where the disk may lack any of them."""
        return self._next_s if self._waiting else 0.0

    def note_records(self) -> None:
        """Count records that were written."""
        self._waiting = self._every_s is not None

    def due(self, now: float) -> bool:
        """Return whether the journal is to be forced onto the disk now; the caller does it before anything else."""
        if self._every_s is None or not self._waiting or now < self._next_s:
            return False
        self._waiting, self._next_s = False, now + self._every_s
        return True
