"""Episode numbers on lease: every number from 1 to N is driven once, whatever happens to the actors."""

from collections.abc import Iterable


class Leases:
    """Who drives which training episode.

    Numbers are handed out in order up to a `barrier` (the next merge), so that no episode is in flight when the
    barrier is reached. A dead actor's numbers are handed out again.
    """

    def __init__(self, finished: Iterable[int] = ()) -> None:
        self.finished: set[int] = set(finished)
        self.holders: dict[int, str] = {}  # number -> actor
        self._lowest_open = 1  # every number below is finished

    def grant(self, actor: str, capacity: int, barrier: int) -> None:
        """Tops `actor` up to `capacity` leases with the lowest free numbers, as long as no more than `barrier` are out.

        Finished numbers count: after an interruption they need not be the lowest ones.
        """
        held = sum(1 for holder in self.holders.values() if holder == actor)
        while self._lowest_open in self.finished:
            self._lowest_open += 1
        number = self._lowest_open
        while held < capacity and len(self.finished) + len(self.holders) < barrier:
            if number not in self.finished and number not in self.holders:
                self.holders[number] = actor
                held += 1
            number += 1

    def finish(self, number: int, actor: str) -> bool:
        """Marks `number` finished; False where `actor` no longer holds it (then the result does not count)."""
        if self.holders.get(number) != actor:
            return False
        del self.holders[number]
        self.finished.add(number)
        return True

    def give_back(self, actor: str) -> list[int]:
        """Frees all that `actor` holds, as after its death; returns the numbers."""
        numbers = sorted(number for number, holder in self.holders.items() if holder == actor)
        for number in numbers:
            del self.holders[number]
        return numbers

    def of(self, actor: str) -> list[int]:
        """The numbers `actor` holds, in order."""
        return sorted(number for number, holder in self.holders.items() if holder == actor)
