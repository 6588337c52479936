"""Actors that take part in a run, as its runner names them: its own ones, and those that join from elsewhere."""

from collections.abc import Iterator
from typing import Literal, NamedTuple

from zsdist.roles.permissions import actor_name
from zsdist.roles.schemas import Supervision


class Change(NamedTuple):
    """Change of the actors.

    Attributes:
        event: name of the event for watchers; empty: nothing that they do not expect.
        actor: name of the actor.
        epoch: epoch that begins, or that ends where the actor has left.
    """

    event: Literal["", "actor_joined", "actor_replaced", "actor_left"]
    actor: str
    epoch: int


class Members:
    """Actors of a run with their newest epochs.

    Args:
        actors: number of the run's own actors, which are never in `left`.

    Attributes:
        epochs: newest epoch of each actor that takes part.
        left: last epoch of each actor that has left for good and has not come back.
    """

    def __init__(self, actors: int) -> None:
        self.epochs: dict[str, int] = {}
        self.left: dict[str, int] = {}
        self._own = set(map(actor_name, range(actors)))

    def follow(self, orders: Supervision, *, admits: bool) -> Iterator[Change]:
        """Yield what the runner's orders change, once each.

        Args:
            orders: newest orders of the runner.
            admits: whether actors that join from elsewhere are taken; a run that ends waits for none.
        """
        for actor, epoch in orders.epochs.items():
            if epoch <= self.epochs.get(actor, -1) or not (admits or actor in self._own or actor in self.epochs):
                continue
            is_known = actor in self.epochs
            self.epochs[actor] = epoch
            event: Literal["", "actor_joined", "actor_replaced"] = "" if actor in self._own else "actor_joined"
            yield Change("actor_replaced" if is_known else event, actor, epoch)
        for actor, epoch in orders.left.items():
            if self.epochs.get(actor, -1) <= epoch and actor not in self._own and self.left.get(actor, -1) < epoch:
                self.epochs.pop(actor, None)
                yield Change("actor_left", actor, epoch)
        self.left = dict(orders.left)
