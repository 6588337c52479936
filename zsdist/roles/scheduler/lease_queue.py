"""Queue of the actors that may drive more episodes than they have been leased."""

from collections.abc import Iterator

from zsdist.roles.scheduler.leases import Leases


class LeaseQueue:
    """Actors that may hold fewer leases than they have cars, in the order in which they began.

    Only these are looked at, so what an episode costs does not grow with the number of actors.

    Args:
        cars: cars of each actor.
    """

    def __init__(self, cars: int) -> None:
        self._cars = cars
        self._places: dict[str, int] = {}  # of all actors
        self._next_place = 0
        self._lacking: set[str] = set()

    def join(self, actor: str) -> None:
        """Add an actor that holds no leases; a new one gets the place behind all others."""
        if actor not in self._places:
            self._places[actor], self._next_place = self._next_place, self._next_place + 1
        self._lacking.add(actor)

    def leave(self, actor: str) -> None:
        """Remove an actor."""
        self._places.pop(actor, None)
        self._lacking.discard(actor)

    def note_finished(self, actor: str) -> None:
        """Note that an actor has finished an episode; one that has left since is not looked at."""
        if actor in self._places:
            self._lacking.add(actor)

    def grant(self, leases: Leases, barrier: int, *, evenly: bool) -> Iterator[tuple[str, int, int]]:
        """Lease episodes to all actors, as many as they have cars; yield the arguments of each successful grant.

        Args:
            leases: leases, from which the arguments are granted.
            barrier: number of episodes that are finished or granted in all, at most.
            evenly: whether to lease one to each actor in turn, so that a few episodes reach all.
        """
        if not self._lacking or not leases.left(barrier):
            return
        lacking = sorted(self._lacking, key=self._places.__getitem__)
        for held in range(1 if evenly else self._cars, self._cars + 1):
            for actor in lacking:
                if not leases.left(barrier):
                    return
                arguments = (actor, held, barrier)
                if leases.grant(*arguments):
                    yield arguments
        self._lacking.clear()  # there were enough for all
