"""Validation drives dealt to the actors, also where actors come and go in the middle of a merge."""

from collections.abc import Collection, Sequence

from zsdist.roles.scheduler.merge import Drive, deal_drives
from zsdist.roles.schemas import CandidateName


class DriveDeal:
    """Actor of each outstanding drive. A drive that was begun stays with its actor, as long as the actor stays.

    Whoever has none left takes over drives that nobody has begun.

    Args:
        begun: number of drives that an actor may have begun, which is that of its cars; it begins them in order.
    """

    def __init__(self, begun: int) -> None:
        self._begun = begun
        self._merge = 0
        self._drives: dict[str, list[Drive]] = {}

    def deal(
        self,
        merge: int,
        outstanding: Sequence[Drive],
        candidates: Sequence[CandidateName],
        actors: Collection[str],
    ) -> dict[str, list[Drive]]:
        """Return the drives of each actor, in the order in which it should begin them.

        Args:
            merge: number of the merge; a new one is dealt from the beginning.
            outstanding: drives that are still wanted.
            candidates: all candidates of the merge.
            actors: names of all actors that take part now.
        """
        before, present = self._drives, sorted(actors)
        if present and (merge != self._merge or not any(before.values())):
            self._drives = deal_drives(outstanding, candidates, present)
        else:
            wanted = set(outstanding)
            self._drives = {actor: [drive for drive in before.get(actor, ()) if drive in wanted] for actor in present}
            dealt = {drive for drives in self._drives.values() for drive in drives}
            for drive in (drive for drive in outstanding if drive not in dealt) if present else ():
                self._drives[min(present, key=self._count)].append(drive)
            if before.keys() != self._drives.keys() or not all(self._drives.values()):
                self._spread()
        self._merge = merge
        return self._drives

    def _spread(self) -> None:
        """Move drives that nobody has begun from those who have most to those who have fewest."""
        while self._drives:
            most, fewest = max(self._drives, key=self._count), min(self._drives, key=self._count)
            if self._count(most) <= max(self._begun, self._count(fewest) + 1):
                return
            self._drives[fewest].append(self._drives[most].pop())

    def _count(self, actor: str) -> int:
        return len(self._drives[actor])
