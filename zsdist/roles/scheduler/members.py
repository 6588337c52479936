"""Actors that take part in a run, as its runner names them: its own ones, and those that join from elsewhere."""

from collections.abc import Iterator, Mapping
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
    """Changes of the actors of a run, which follow from the runner's orders.

    Args:
        actors: number of the run's own actors.

    Attributes:
        left: last epoch of each actor that has left and has not come back.
    """

    def __init__(self, actors: int) -> None:
        self.left: dict[str, int] = {}
        self._own = set(map(actor_name, range(actors)))

    def changes(self, orders: Supervision, epochs: Mapping[str, int], *, admits: bool) -> Iterator[Change]:
        """Yield what the runner's orders change, once each.

        Args:
            orders: newest orders of the runner.
            epochs: newest epoch of each actor that takes part; the caller applies each change to it.
            admits: whether actors that join from elsewhere are taken; a run that ends waits for none.
        """
        for actor, epoch in orders.epochs.items():
            is_own, is_known = actor in self._own, actor in epochs
            returns = is_known or (is_own and actor in self.left)  # a guest that comes back joins once more
            if epoch > epochs.get(actor, -1) and (admits or is_own or is_known):
                yield Change("actor_replaced" if returns else "" if is_own else "actor_joined", actor, epoch)
        for actor, epoch in orders.left.items():
            if epochs.get(actor, -1) <= epoch and self.left.get(actor, -1) < epoch:
                yield Change("actor_left", actor, epoch)
        self.left = dict(orders.left)
