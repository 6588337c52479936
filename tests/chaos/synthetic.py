"""Actor without cars, which pushes random trajectories of both levels as fast as its credit allows."""

import numpy as np

from zsdist.roles.actor_outboxes import ActorOutboxes, CreditAccount
from zsdist.roles.base import Role
from zsdist.roles.schemas import ActorOrders
from zsdist.roles.shapes import SHAPES
from zsdist.types import NO_GUIDE, Ack, Level, Trajectory
from zsdist.wire import keys
from zsdist.wire.messages import Orders

LENGTH = 128
DISTINCT = 64
A_ROUND = 8  # trajectories of each level in one step


class SyntheticActor(Role):
    """Actor of a run whose episodes never end.

    Args:
        context: identity of the role.
    """

    def __init__(self, context):
        super().__init__(context)
        self._outboxes = ActorOutboxes(context.run, context.name, context.epoch, context.config.transport)
        rng = np.random.default_rng(context.epoch)
        self._trajectories = {level: [_trajectory(level, rng) for _ in range(DISTINCT)] for level in Level}
        self._pushed, self._closing = 0, False
        self._acks, self._orders = self.mailbox("acks"), self.mailbox("orders")
        self.transport.subscribe(keys.ack(context.run, context.name), self._acks)
        self.transport.subscribe(keys.control(context.run, "actor"), self._orders, retained=True)

    def work(self, now):
        """Push, and close at the end of the run."""
        for _, ack in self.messages(self._acks, Ack):
            self._outboxes.on_ack(ack, now)
        for content in self.orders(self._orders, {Orders: ActorOrders}):
            if content.closing and not self._closing:
                self._closing = True
                self._outboxes.close()
        if not self._closing:
            self._push()
        self._outboxes.flush(self.transport, now)
        self.finished = self._closing and self._outboxes.drained
        return now + 0.002

    def statistics(self):
        """Return the number of trajectories and the counts of the outboxes."""
        return {"env_steps": self._pushed * LENGTH, **self._outboxes.statistics()}

    def _push(self):
        for _ in range(A_ROUND):
            if any(self._outboxes.statistics()[f"{level}_waiting"] > 4 * LENGTH for level in Level):
                return
            account = CreditAccount(pending=dict.fromkeys(Level, LENGTH - 1))
            if not self._outboxes.reserve(account):
                self._outboxes.release(account)
                return
            self._outboxes.offer([self._trajectories[level][self._pushed % DISTINCT] for level in Level], account)
            self._pushed += 1


def _trajectory(level, rng):
    shape = SHAPES[level]
    return Trajectory(
        level,
        rng.normal(size=(LENGTH + 1, shape.state_size)).astype(np.float32),
        rng.integers(0, shape.actions, LENGTH).astype(np.uint8),
        rng.normal(size=LENGTH).astype(np.float32),
        np.full(LENGTH, 0.9, np.float32),
        np.arange(1, LENGTH + 1, dtype=np.uint16),
        np.ones((LENGTH + 1, shape.actions), bool),
        np.full(LENGTH, NO_GUIDE, np.int8),
        np.zeros(LENGTH, np.uint8),
        0,
    )
