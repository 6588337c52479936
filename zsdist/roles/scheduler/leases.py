"""Leases of episode numbers: each number from 1 to N is driven once, even when actors die."""

from collections.abc import Iterable


class Leases:
    """Assignment of training episodes to actors.

    Numbers are granted in order up to a `barrier` (the next merge), so that no episode is in flight when the barrier is
    reached. The numbers of a dead actor are granted again.
    """

    def __init__(self, finished: Iterable[int] = ()) -> None:
        self.finished: set[int] = set(finished)
        self.holders: dict[int, str] = {}  # number -> actor
        self._lowest_open = 1  # every number below is finished

    def grant(self, actor: str, capacity: int, barrier: int) -> None:
        """Grant the lowest free numbers to `actor` until it holds `capacity` of them.

        At most `barrier` numbers are finished or granted in all. Finished numbers are counted and not compared with the
        barrier, since after an interruption they need not be the lowest ones.
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
        """Mark `number` finished; return False, and change nothing, where `actor` does not hold it (any more)."""
        if self.holders.get(number) != actor:
            return False
        del self.holders[number]
        self.finished.add(number)
        return True

    def give_back(self, actor: str) -> list[int]:
        """Free all numbers that `actor` holds, as after its death, and return them."""
        numbers = sorted(number for number, holder in self.holders.items() if holder == actor)
        for number in numbers:
            del self.holders[number]
        return numbers

    def held_by(self, actor: str) -> list[int]:
        """Return the numbers that `actor` holds, in order."""
        return sorted(number for number, holder in self.holders.items() if holder == actor)
