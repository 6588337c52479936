"""Leases of episode numbers: each number from 1 to N is driven once, even when actors die."""

import heapq
from collections.abc import Iterable
from typing import Any


class Leases:
    """Assignment of training episodes to actors.

    Numbers are granted in order up to a `barrier`, so that no episode is in flight when the barrier is reached. The
    numbers of a dead actor are granted again. Memory and time depend on the numbers that are not finished, not on those
    that are.

    Attributes:
        holders: actor that holds each number.
        finished_count: count of finished numbers.
        changed: actors whose numbers have changed since `take_changed`.
    """

    def __init__(self, finished: Iterable[int] = ()) -> None:
        done = set(finished)
        self.holders: dict[int, str] = {}
        self.finished_count = len(done)
        self.changed: set[str] = set()
        self._held: dict[str, set[int]] = {}  # numbers that each actor holds
        self._next = max(done, default=0) + 1  # this and all higher numbers have never been granted
        self._free = [number for number in range(1, self._next) if number not in done]  # lower ones to grant: a heap

    @property
    def finished(self) -> set[int]:
        """All finished numbers."""
        return set(range(1, self._next)) - self.holders.keys() - set(self._free)

    def left(self, barrier: int) -> int:
        """Return how many numbers may be granted; `barrier` as in `grant`."""
        return max(0, barrier - self.finished_count - len(self.holders))

    def grant(self, actor: str, capacity: int, barrier: int) -> bool:
        """Grant the lowest free numbers to `actor` until it holds `capacity` of them; return whether any was granted.

        At most `barrier` numbers are finished or granted in all. Finished numbers are counted and not compared with the
        barrier, since after an interruption they need not be the lowest ones.
        """
        held = self._held.setdefault(actor, set())
        before = len(held)
        while len(held) < capacity and self.left(barrier):
            if self._free:
                number = heapq.heappop(self._free)
            else:
                number, self._next = self._next, self._next + 1
            self.holders[number] = actor
            held.add(number)
        if len(held) > before:
            self.changed.add(actor)
        return len(held) > before

    def take_changed(self) -> set[str]:
        """Return the actors whose numbers have changed since the last call."""
        changed, self.changed = self.changed, set()
        return changed

    def finish(self, number: int, actor: str) -> bool:
        """Mark `number` finished; return False, and change nothing, where `actor` does not hold it (any more)."""
        if self.holders.get(number) != actor:
            return False
        del self.holders[number]
        self._held[actor].remove(number)
        self.changed.add(actor)
        self.finished_count += 1
        return True

    def give_back(self, actor: str) -> list[int]:
        """Free all numbers that `actor` holds, as after its death, and return them."""
        self.changed.add(actor)
        numbers = sorted(self._held.pop(actor, ()))
        for number in numbers:
            del self.holders[number]
            heapq.heappush(self._free, number)
        return numbers

    def held_by(self, actor: str) -> list[int]:
        """Return the numbers that `actor` holds, in order."""
        return sorted(self._held.get(actor, ()))

    def state(self) -> dict[str, Any]:
        """Return all leases as plain data, for `restore`; its size depends on the numbers that are not finished."""
        held = {actor: sorted(numbers) for actor, numbers in self._held.items() if numbers}
        return {"finished_count": self.finished_count, "next": self._next, "free": sorted(self._free), "held": held}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        self.finished_count, self._next = state["finished_count"], state["next"]
        self._free = list(state["free"])  # sorted, which is a heap
        self._held = {actor: set(numbers) for actor, numbers in state["held"].items()}
        self.holders = {number: actor for actor, numbers in self._held.items() for number in numbers}
