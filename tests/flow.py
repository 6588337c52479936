"""Real replay, learners and outboxes around synthetic cars, on a virtual clock: a run without simulation."""

import json
import threading
from collections import Counter

import numpy as np

from zsdist.dqn.fused import FusedDqnLearner
from zsdist.driving.perception import Perception
from zsdist.roles.actor import Actor
from zsdist.roles.actor_outboxes import ActorOutboxes, CreditAccount
from zsdist.roles.base import HEARTBEAT_S, Context
from zsdist.roles.learner import Learner
from zsdist.roles.replay import shards
from zsdist.roles.replay.role import Replay
from zsdist.roles.scheduler.role import Scheduler
from zsdist.roles.shapes import SHAPES as REAL_SHAPES
from zsdist.roles.shapes import Shape
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import NO_GUIDE, Ack, Level, Trajectory
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders

RUN, TICK_S = "flow", 0.05
SHAPES = dict.fromkeys(Level, Shape(3, 2))


def trajectory(level, steps, shape=SHAPES[Level.LOW]):
    """Return a valid trajectory."""
    return Trajectory(
        level=level,
        states=np.zeros((steps + 1, shape.state_size), np.float32),
        actions=np.zeros(steps, np.uint8),
        rewards=np.zeros(steps, np.float32),
        discounts=np.full(steps, 0.5, np.float32),
        successors=np.arange(1, steps + 1, dtype=np.uint16),
        masks=np.ones((steps + 1, shape.actions), bool),
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
        learner = {"learning": True, "merge": 0, "candidates": [], "chosen": "", "stop": False}
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


class InstantCar:
    """Car whose episodes take one action; it has the interface of `zsdist.driving.actor_car.ActorCar`."""

    def __init__(self):
        self.task, self.over, self.candidate_q = None, False, None
        self._finished = [trajectory(level, 1, shape) for level, shape in REAL_SHAPES.items()]

    @property
    def idle(self):
        return self.task is None

    @property
    def trains(self):
        return self.task.trains

    def begin(self, task, versions, candidate_q=None):
        self.task, self.over, self.candidate_q = task, False, candidate_q
        self._ready = []

    def advance(self, view, q):
        if self.over and self.trains:
            self._ready = self._finished
        self.over = True

    def drain(self):
        ready, self._ready = self._ready, []
        return ready

    def cut(self):
        self.task = None
        return []

    def record(self):
        task, self.task = self.task, None
        about = {"episode": task.number} if task.trains else {"scene_index": task.number}
        candidate = {} if task.trains else {"merge": task.merge, "candidate": task.candidate}
        drive = {"scene": "none", "outcome": "success", "steps": 1, "return": 1.0, "epsilon": task.epsilon}
        where = {"start": [0.0, 0.0], "goal": [1.0, 1.0], "path": [[0.0, 0.0]]}
        return about | candidate | drive | where | {"shielded": True, "path_m": 1.0}


class NoPictures(Perception):
    """Perception of cars that need no views."""

    def __init__(self):
        pass

    def views(self, cars):
        return [None] * len(cars)

    def statistics(self):
        return {}

    def close(self):
        pass


class NoScenes:
    """Source of scenes for cars that drive none."""

    def training(self, number):
        return None

    def validation(self, merge, index):
        return None


class NoFiles:
    """Run log that writes nothing and counts checkpoints."""

    def __init__(self):
        self.checkpoints = 0

    def begin_checkpoint(self, episodes, states, score):
        self.checkpoints += 1
        return lambda: None

    def episode(self, record):
        pass

    def metrics(self, row):
        pass

    def summary(self, fields):
        pass

    def wall_s(self):
        return 0.0


class WholeRun:
    """All roles of a run around instant cars, stepped in turn on a virtual clock as `zsdist.run.inline` does.

    Args:
        config: configuration of the run.
        folder: folder of journals and ledger.
        there: numbers of its own actors that are there; None: all.
    """

    def __init__(self, config, folder, there=None):
        self.config, self.now, self.broker, self.log = config, 0.0, MemoryBroker(), NoFiles()
        self._supervisor, self._watched = MemoryTransport(self.broker), Mailbox(2**24)
        self._supervisor.subscribe(keys.events(RUN), self._watched)
        self.events = Counter()
        self.scheduler = Scheduler(self._context("scheduler", "0"), self.log, folder / "ledger")
        shapes, actors = REAL_SHAPES, range(config.run.actors) if there is None else there
        self._roles = [self.scheduler, Replay(self._context("replay", "0"), shapes, folder / "journal")]
        for level, shape in shapes.items():
            dqn = FusedDqnLearner(shape.state_size, shape.actions, config.low, seed=0)
            self._roles.append(Learner(self._context("learner", level), level, dqn))
        for index in actors:
            cars = [InstantCar() for _ in range(config.run.cars_per_actor)]
            self._roles.append(Actor(self._context("actor", str(index)), cars, NoPictures(), NoScenes()))
        self._due_s = dict.fromkeys(self._roles, 0.0)
        content = {"epochs": {f"actor-{i}": 1 for i in actors}, "restarts": {}, "interrupted": False}
        orders = codec.encode(Orders(1, "scheduler", content))
        self._supervisor.publish(keys.control(RUN, "scheduler"), orders, retained=True)

    def _context(self, role, identifier, epoch=1):
        transport = MemoryTransport(self.broker, role)
        return Context(self.config, RUN, role, str(identifier), epoch, transport, threading.Event())

    @property
    def merges(self):
        """Number of merges that have ended."""
        return len(self.scheduler.progress.totals.merges)

    def held(self):
        """Return the numbers of retained values, tokens, subscriptions and services of all roles."""
        sizes = ((len(t.kept), len(t.tokens), len(t.subscriptions), len(t.services)) for t in self.broker.transports)
        return tuple(map(sum, zip(*sizes, strict=True)))

    def drive(self, merges, give_up_s):
        """Step until a number of merges have ended, or for `give_up_s` of virtual time."""
        until_s = self.now + give_up_s
        while self.merges < merges and self.now < until_s:
            self.step()
        return self.merges

    def add(self, role):
        """Step a further role from now on."""
        self._roles.append(role)
        self._due_s[role] = self.now

    def remove(self, role):
        """End a role at once, as if its process had died."""
        self._roles.remove(role)
        del self._due_s[role]
        role.transport.close()

    def step(self):
        """Let all roles work that have something to do, and advance the clock."""
        worked = False
        for role in self._roles:
            due_s, wake = self._due_s[role], role.context.wake
            if due_s is not None and (due_s <= self.now or wake.is_set()):
                wake.clear()
                self._due_s[role] = role.step(self.now)
                worked = True
        for message in self._watched.drain():
            self.events[json.loads(message.payload)["event"]] += 1
        due = [due_s for due_s in self._due_s.values() if due_s is not None]
        self.now = self.now + TICK_S if worked else max(self.now, min(due, default=self.now + TICK_S))
