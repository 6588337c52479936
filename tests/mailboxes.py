"""A single role; the test plays all others at the other end of a memory transport."""

import json
import threading

from fakes import FakeVisualAct

from zsdist.config import parse
from zsdist.dqn import network
from zsdist.dqn.learner import DqnLearner
from zsdist.roles.actor import Actor
from zsdist.roles.base import Context
from zsdist.roles.learner import Learner
from zsdist.roles.replay.role import Replay
from zsdist.roles.scheduler.role import Scheduler
from zsdist.roles.shapes import SHAPES
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level
from zsdist.wire import codec, keys

RUN, CONFIG = "test", parse({"low": {"hidden": (8,)}, "high": {"hidden": (8,)}})
LOW = SHAPES[Level.LOW]
PARAMETERS = network.initial_parameters(LOW.state_size, LOW.actions, (4,), seed=0)
REPLAY = {"epochs": {"actor-0": 7}, "buffer_size": 2000, "batch_size": 16, "stop": False}


class NoRunLog:
    """Run log that accepts everything that a scheduler writes, and stores nothing."""

    def __getattr__(self, name):
        return lambda *arguments: 0.0


class Bench:
    """One role at a memory transport, with the other end for the test."""

    def __init__(self, role, folder, **settings):
        broker, self.now = MemoryBroker(), 0.0
        self.others, self.stats, self.answers = MemoryTransport(broker), Mailbox(2**20), Mailbox(2**26)
        self.others.subscribe(keys.stats(RUN, keys.ANY, keys.ANY), self.stats)
        kind, _, identifier = role.partition("-")
        config = CONFIG.model_copy(
            update={name: getattr(parse({name: value}), name) for name, value in settings.items()}
        )
        context = Context(config, RUN, kind, identifier, 9, MemoryTransport(broker), threading.Event())
        match kind:
            case "replay":
                self.role = Replay(context, SHAPES, folder)
            case "scheduler":
                self.role = Scheduler(context, NoRunLog(), folder)
            case "learner":
                self.role = Learner(context, Level.LOW, DqnLearner(LOW.state_size, LOW.actions, CONFIG.low, seed=0))
            case "actor":
                self.role = Actor(context, [], NoPerception(), None)

    def send(self, key, payload):
        self.others.publish(key, payload if isinstance(payload, bytes) else codec.encode(payload))

    def refused(self):
        """Counts of refused messages by reason, as published after one step."""
        self.now += 1.0
        assert self.role.step(self.now) is not None
        fields = json.loads(self.stats.drain()[-1].payload)
        return {name.removeprefix("rejected_"): count for name, count in fields.items() if name.startswith("rejected_")}


class NoPerception:
    """Perception of an actor without cars."""

    visual_act = FakeVisualAct()

    def statistics(self):
        return {}
