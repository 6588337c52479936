"""Real replay, learners and outboxes around synthetic cars, on a virtual clock: the flow of a run without simulation."""

import threading

import numpy as np

from zsdist.dqn.fused import FusedDqnLearner
from zsdist.roles.actor_outboxes import ActorOutboxes, CreditAccount
from zsdist.roles.base import HEARTBEAT_S, Context
from zsdist.roles.learner import Learner
from zsdist.roles.replay import shards
from zsdist.roles.replay.role import Replay
from zsdist.roles.shapes import Shape
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import NO_GUIDE, Ack, Level, Trajectory
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders

RUN, TICK_S = "flow", 0.05
SHAPES = dict.fromkeys(Level, Shape(3, 2))


def trajectory(level, steps, reward=0.0):
    """Return a valid trajectory of `SHAPES`."""
    return Trajectory(
        level=level,
        states=np.zeros((steps + 1, 3), np.float32),
        actions=np.zeros(steps, np.uint8),
        rewards=np.full(steps, reward, np.float32),
        discounts=np.full(steps, 0.5, np.float32),
        successors=np.arange(1, steps + 1, dtype=np.uint16),
        masks=np.ones((steps + 1, 2), bool),
        guides=np.full(steps, NO_GUIDE, np.int8),
        behaviours=np.zeros(steps, np.uint8),
        weight_version=1,
    )


class SyntheticActors:
    """Cars of many actors, which drive options of the longest kind with the credit of real outboxes."""

    def __init__(self, transport, config, epochs):
        self._transport, self._longest = transport, config.agent.option_max_steps
        self._ended = {level: trajectory(level, self._longest) for level in Level}
        self._acks = Mailbox(2**30)
        transport.subscribe(keys.ack(RUN, keys.ANY), self._acks)
        cars = range(config.run.cars_per_actor)
        self.outboxes = {name: ActorOutboxes(RUN, name, epoch, config.transport) for name, epoch in epochs.items()}
        self._cars = {name: [CreditAccount() for _ in cars] for name in epochs}
        self.options = {name: 0 for name in epochs}  # ended

    def step(self, now):
        """Let every car act for which there is credit, as a real actor does."""
        for message in self._acks.drain():
            ack = codec.decode(message.payload, expect=Ack)
            self.outboxes[ack.actor].on_ack(ack, now)
        for name, outboxes in self.outboxes.items():
            for account in self._cars[name]:
                if not outboxes.reserve(account):
                    continue
                over = account.pending[Level.LOW] == self._longest  # noticed in the step after it
                account.count_step()
                if over:
                    self.options[name] += 1
                    outboxes.offer(list(self._ended.values()), account)
            outboxes.flush(self._transport, now)


class Flow:
    """Synthetic actors, all shards of the replay and both learners; the test gives the orders of the scheduler."""

    def __init__(self, config, folder):
        self.config, self.now, self._next_orders_s = config, 0.0, 0.0
        self.broker = MemoryBroker()
        self.epochs = {f"actor-{index}": index + 1 for index in range(config.run.actors)}
        self._others = MemoryTransport(self.broker)
        self.actors = SyntheticActors(self._others, config, self.epochs)
        self.replays = [
            Replay(self._context("replay", str(index)), SHAPES, folder / str(index))
            for index in range(config.replay.shards)
        ]
        self.learners = [Learner(self._context("learner", level), level, make_dqn(config)) for level in Level]

    def _context(self, role, identifier):
        transport = MemoryTransport(self.broker, role)
        return Context(self.config, RUN, role, str(identifier), 1, transport, threading.Event())

    def order(self):
        """Publish the orders that actors may push and learners may learn."""
        sizes = {"buffer_size": self.config.replay.size_initial, "batch_size": self.config.replay.batch_initial}
        learner = {"learning": True, "merge": 0, "phase": "", "candidates": [], "chosen": "", "stop": False}
        for role, content in (
            (shards.ROLE, {"epochs": self.epochs, "stop": False} | sizes),
            ("learner", learner),
        ):
            self._others.publish(keys.control(RUN, role), codec.encode(Orders(1, role, content)))

    def step(self):
        """Let all parts work once, the learners as long as they have batches."""
        if self.now >= self._next_orders_s:
            self._next_orders_s = self.now + HEARTBEAT_S
            self.order()
        self.actors.step(self.now)
        for _ in range(8):
            for replay in self.replays:
                replay.step(self.now)
            learned = [learner.step(self.now) == self.now for learner in self.learners]
            if not any(learned):
                break
        self.now += TICK_S

    def drive(self, options, give_up_s):
        """Step until every actor has ended a number of options; return the least number after `give_up_s`."""
        while min(self.actors.options.values()) < options and self.now < give_up_s:
            self.step()
        return min(self.actors.options.values())


def make_dqn(config):
    """Return a small network of `SHAPES`."""
    shape = SHAPES[Level.LOW]
    return FusedDqnLearner(shape.state_size, shape.actions, config.low, seed=0)
