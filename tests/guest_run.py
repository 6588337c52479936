"""Whole runs of instant cars on a virtual clock, which actors join from elsewhere."""

import threading
from pathlib import Path
from types import SimpleNamespace

from flow import RUN, InstantCar, NoFiles, NoPictures, NoScenes, WholeRun

from zsdist.config import parse
from zsdist.roles import schemas
from zsdist.roles.actor import Actor
from zsdist.roles.base import HEARTBEAT_S, Context
from zsdist.roles.scheduler.progress import Stage
from zsdist.roles.schemas import JoinTerms, JoinVerdict
from zsdist.run import program
from zsdist.run.guests import Guests
from zsdist.run.program import RoleSpec
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryTransport
from zsdist.types import Level
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire import codec, keys
from zsdist.wire.messages import Admission, Orders

GIVE_UP_S = 300.0


class Pages(NoFiles):
    """Run log that keeps the finished episodes and the summary."""

    def __init__(self):
        super().__init__()
        self.episodes, self.summaries = [], []

    def episode(self, record):
        self.episodes.append((record["episode"], record["actor"]))

    def summary(self, fields):
        self.summaries.append(fields)


class SlowCar(InstantCar):
    """Car whose episodes take several actions."""

    actions = 12

    def begin(self, task, versions, candidate_q=None):
        super().begin(task, versions, candidate_q)
        self._left = self.actions

    def advance(self, view, q):
        self._left -= 1
        if self._left <= 0:
            super().advance(view, q)


class GuestRun(WholeRun):
    """Run with a runner that admits guests; `own` is the only actor of its own."""

    def __init__(self, folder: Path, there=None, **settings):
        defaults = {
            "run": {"actors": 1, "cars_per_actor": 2, "episodes": 60, "checkpoint_every_episodes": 1000},
            "merge": {"every_episodes": 0},
            "low": {"min_size": 8, "updates_per_insert": 0.02},  # the networks are not what is tested
            "high": {"min_size": 8, "updates_per_insert": 0.02},
        }
        merged = {name: {**defaults.get(name, {}), **settings.get(name, {})} for name in defaults | settings}
        super().__init__(parse(merged), folder, there)
        self.log = self.scheduler.run_log = Pages()
        self.interrupted = False
        self.asked = MemoryTransport(self.broker)
        self._runner, self._answers = MemoryTransport(self.broker), Mailbox(2**20)
        self._next_epoch, self._next_orders_s = 100, 0.0
        vision = VisionIdentity("made up", "1" * 64, "head", "2" * 64)
        self.spec = SimpleNamespace(config=self.config, run=RUN, start="start", vision=vision)
        self.guests = Guests(self.spec, self._runner, self._issue)
        self.actors = {}

    def _issue(self):
        self._next_epoch += 1
        return self._next_epoch

    @property
    def stage(self):
        return self.scheduler.stage

    @property
    def merging(self):
        return self.scheduler.progress.merge is not None

    def ask(self, what, actor, joiner="one", process="first"):
        """Return the run's answer to a question."""
        content = {"ask": what, "joiner": joiner, "process": process}
        payload = codec.encode(Admission(actor, content))
        self.asked.request(keys.join(RUN, actor), payload, self._answers, timeout_s=1.0)
        self.guests.step(self.now)
        (message,) = self._answers.drain()
        answer = codec.decode(message.payload, expect=Admission).content
        return schemas.read(JoinTerms if what == "terms" else JoinVerdict, answer)

    def join(self, number, **words):
        """Return an actor that takes part from now on."""
        name = f"actor-{number}"
        epoch = self.ask("epoch", name, **words).epoch
        transport = MemoryTransport(self.broker, name)
        context = Context(self.config, RUN, "actor", str(number), epoch, transport, threading.Event())
        cars = [SlowCar() for _ in range(self.config.run.cars_per_actor)]
        self.actors[name] = Actor(context, cars, NoPictures(), NoScenes())
        self.add(self.actors[name])
        return self.actors[name]

    def own(self):
        """Return the run's own actors that are there, and the last epochs of those that were."""
        return [RoleSpec("actor", "0", 1)], {}

    def leave(self, actor, process="first"):
        """Let an actor deliver everything and say goodbye, as its process does."""
        actor.leave()
        self.until(lambda: actor.finished)
        self.ask("leave", actor.context.name, process=process)
        self.remove(actor)

    def step(self):
        if self.now >= self._next_orders_s:
            self._next_orders_s = self.now + HEARTBEAT_S
            self.guests.step(self.now)
            own, left = self.own()
            content = program.supervision(
                own, interrupted=self.interrupted, guests=self.guests.epochs, left=self.guests.left | left
            )
            orders = codec.encode(Orders(1, "scheduler", content))
            self._runner.publish(keys.control(RUN, "scheduler"), orders, retained=True)
        super().step()

    def until(self, condition, give_up_s=GIVE_UP_S):
        """Step until a condition holds."""
        end_s = self.now + give_up_s
        while not condition():
            assert self.now < end_s, f"it does not happen; the run is in stage {self.stage}"
            self.step()

    def wait(self, seconds):
        """Step for a time."""
        end_s = self.now + seconds
        self.until(lambda: self.now >= end_s)

    def finish(self):
        """Drive to the end of the run; check its books, and that each episode was finished once."""
        self.until(lambda: self.stage is Stage.DONE)
        (summary,) = self.log.summaries
        for level in Level:
            books = summary["transitions"][level]
            assert books["produced"] == books["stored"] + books["rejected"], f"{level} does not balance: {books}"
        numbers = [number for number, _ in self.log.episodes]
        assert len(set(numbers)) == len(numbers) == summary["episodes"]
        if not self.interrupted:
            assert sorted(numbers) == list(range(1, self.config.run.episodes + 1))
        return summary

    def drivers(self):
        """Return the actors that have finished episodes."""
        return {actor for _, actor in self.log.episodes}
