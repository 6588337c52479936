"""A scheduler that dies at any write, of any kind, in any stage: its successor ends the run as if nothing had been.

The scheduler and its files are real, and so are the outboxes of the actors; supervisor, cars, learners and replay are
played by the test, on a virtual clock.
"""

import json
import os
from collections import Counter
from functools import partial

import episode_records
import numpy as np
import pytest

from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.protocol.outbox import Outbox
from zsdist.replay import journal
from zsdist.replay.journal import Journal
from zsdist.roles.base import Context
from zsdist.roles.scheduler.ledger import Ledger
from zsdist.roles.scheduler.progress import RunProgress, Stage
from zsdist.roles.scheduler.role import Scheduler
from zsdist.run.directory import RunDirectory
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Ack, Level, Weights
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, EVALUATION, Candidate, Jobs, Orders, Records, State, WeightsMessage

RUN, TICK_S, PATIENCE_S = "test", 0.05, 60.0
VISION = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
WEIGHTS = {"w": np.zeros(1, np.float32)}
ACTORS = ("actor-0", "actor-1")
CONFIG = parse(
    {
        "run": {"actors": 2, "cars_per_actor": 2, "episodes": 7, "checkpoint_every_episodes": 2},
        "merge": {"every_episodes": 4, "validation_scenes": 2, "drop_after_scenes": 1},
    }
)
RECORD = episode_records.RECORD | {"path": [[0.0, 0.0]] * 5}


class KilledError(Exception):
    """The process of the scheduler is gone, in the middle of what it did."""


class Fate:
    """Count of what a scheduler does outside itself; at a given one of these deeds it is killed instead."""

    def __init__(self):
        self.deeds, self.fatal = [], None

    def __call__(self, deed):
        self.deeds.append(deed)
        if self.fatal is not None and len(self.deeds) > self.fatal:
            self.fatal = None
            raise KilledError(deed)


class WatchedTransport(MemoryTransport):
    """Transport of a scheduler whose fate is watched."""

    def __init__(self, broker, fate):
        super().__init__(broker)
        self._fate = fate

    def publish(self, key, payload, **options):
        self._fate(key.split("/")[2])
        super().publish(key, payload, **options)

    def request(self, key, payload, mailbox, **options):
        self._fate("request")
        super().request(key, payload, mailbox, **options)


class WatchedLog:
    """Run directory of a scheduler whose fate is watched; where it is killed, it leaves half a line."""

    def __init__(self, folder, fate):
        self._folder, self._log, self._fate = folder, RunDirectory(folder, VISION), fate

    def __getattr__(self, name):
        if name == "wall_s":
            return self._log.wall_s
        return partial(self._do, name)

    def _do(self, name, *arguments):
        try:
            self._fate(name)
        except KilledError:
            file = {"episode": "episodes.jsonl", "metrics": "metrics.jsonl"}.get(name)
            if file is not None:
                with (self._folder / file).open("a") as lines:
                    lines.write('{"finished_as": 1, "epi')
            raise
        return getattr(self._log, name)(*arguments)

    def close(self):
        self._log.close()


class PlayedActor:
    """Actor whose cars drive an episode in three rounds; it obeys the newest scheduler alone, as a real one does."""

    def __init__(self, name, epoch, transport, driven):
        self.name, self.epoch, self.driven = name, epoch, driven
        self._transport, self._box = transport, Mailbox(2**24)
        self._outboxes = {
            stream: Outbox(
                stream, name, epoch, window_frames=8, resend_after_s=0.5, give_up_after_s=20.0, make_frame=Records
            )
            for stream in (EPISODES, EVALUATION)
        }
        self._keys = {EPISODES: keys.episodes(RUN, name, epoch), EVALUATION: keys.evaluation(RUN, name)}
        self._orders_epoch, self._started, self._cars = -1, set(), {}
        self._leases, self._jobs, self._closing, self._named, self._ends = [], None, False, False, False
        transport.subscribe(keys.ack(RUN, name), self._box)
        transport.subscribe(keys.control(RUN, "actor"), self._box, retained=True)
        transport.subscribe(keys.evaluation(RUN, name), self._box, retained=True)

    @property
    def drained(self):
        return all(outbox.drained for outbox in self._outboxes.values())

    def step(self, now):
        for message in self._box.drain():
            match codec.decode(message.payload):
                case Ack() as ack:
                    self._outboxes[ack.stream].on_ack(ack, now)
                case Orders(epoch, _, content) if epoch >= self._orders_epoch:
                    self._orders_epoch, self._ends = epoch, content["closing"]
                case Jobs(epoch, _, content) if epoch >= self._orders_epoch:
                    self._orders_epoch, self._named = epoch, content["epoch"] == self.epoch
                    if self._named:
                        self._leases, self._jobs = content["leases"], content
        if self._named:
            self._closing = self._ends
        self._drive()
        if self._closing and not self._cars:
            for outbox in self._outboxes.values():
                outbox.close()
        for stream, outbox in self._outboxes.items():
            assert not outbox.stuck(now) and not outbox.refusal
            for frame in outbox.poll(now):
                self._transport.publish(self._keys[stream], codec.encode(frame))

    def _drive(self):
        tasks = [(self._jobs["merge"], *drive) for drive in self._jobs["drives"]] if self._jobs else []
        for task in [*tasks, *self._leases]:
            if task not in self._started and len(self._cars) < CONFIG.run.cars_per_actor and not self._closing:
                self._started.add(task)
                self._cars[task] = 0
                self.driven[task] += 1
        for task in list(self._cars):
            self._cars[task] += 1
            if self._cars[task] == 3:
                del self._cars[task]
                self._report(task)

    def _report(self, task):
        if isinstance(task, int):
            about = {"episode": task, "outcome": "success" if task % 3 else "timeout", "steps": 10 + task}
            self._outboxes[EPISODES].offer([RECORD | {"actor": self.name} | about])
            return
        merge, candidate, scene = task
        about = {"merge": merge, "candidate": candidate, "scene_index": scene, "steps": 5}
        about["outcome"] = "success" if candidate == "distilled" else "collision"
        self._outboxes[EVALUATION].offer([RECORD | {"actor": self.name} | about])


class PlayedOthers:
    """Learners and replay: they offer candidates, promote winners, and answer with their states."""

    def __init__(self, transport):
        self._transport, self._asked, self._orders = transport, Mailbox(2**24), Mailbox(2**24)
        self._epoch, self._offered, self._promoted, self.stopped = -1, 0, 0, False
        for role in ("replay", "learner-high", "learner-low"):
            transport.serve(keys.control(RUN, role), self._asked)
        transport.subscribe(keys.control(RUN, "learner"), self._orders, retained=True)

    def step(self):
        for message in self._orders.drain():
            orders = codec.decode(message.payload)
            if orders.sender_epoch >= self._epoch:
                self._epoch = orders.sender_epoch
                self._follow(orders.content)
        for request in self._asked.drain():
            role = codec.decode(request.payload).role
            part = {"open": 0, "books": {"stored": 1}}
            learner = {"version": 1, "updates": 1, "merge": self._promoted, "sha256": "0" * 64}
            request.reply(codec.encode(State(role, {"high": part, "low": part} if role == "replay" else learner, {})))

    def _follow(self, content):
        merge, self.stopped = content["merge"], content["stop"]
        if merge > self._offered:
            self._offered = merge
            for level in Level:
                for name in content["candidates"]:
                    candidate = codec.encode(Candidate(1, level, merge, name, WEIGHTS))
                    self._transport.publish(keys.candidate(RUN, level, name), candidate, retained=True)
        if content["chosen"] and merge > self._promoted:
            self._promoted = merge
            for level in Level:
                message = WeightsMessage(1, merge, "0" * 64, 0.0, Weights(level, merge, WEIGHTS))
                self._transport.publish(keys.weights(RUN, level), codec.encode(message), retained=True)


class Play:
    """A whole run; `fatal` names deeds of the scheduler, each counted from the birth of one, that kill it."""

    def __init__(self, folder, fate, fatal=(), actor_dies_at_s=None, interrupted_at_s=None):
        folder.mkdir()
        self.folder, self.fate, self.fatal = folder, fate, list(fatal)
        self.actor_dies_at_s, self.interrupted_at_s = actor_dies_at_s, interrupted_at_s
        self.now, self.epoch, self.kills, self.driven = 0.0, 100, [], Counter()
        self.broker, self.events = MemoryBroker(), Mailbox(2**24)
        self.supervisor = MemoryTransport(self.broker)
        self.supervisor.subscribe(keys.events(RUN), self.events)
        self.others = PlayedOthers(MemoryTransport(self.broker))
        self.actors = {name: PlayedActor(name, 7, MemoryTransport(self.broker), self.driven) for name in ACTORS}
        self.restarts = Counter()
        self.scheduler = None

    def run(self):
        while not (self.scheduler and self.scheduler.finished and self.others.stopped):
            assert self.now < PATIENCE_S, f"the run does not end after deaths at {self.kills}"
            self.now += TICK_S
            try:
                self.advance()
            except KilledError as death:
                self.kills.append(str(death))
                self.restarts["scheduler"] += 1
                self.bury()
        self.bury()
        return json.loads((self.folder / "summary.json").read_text())

    def advance(self):
        if self.scheduler is None:
            self.begin()
        if self.actor_dies_at_s is not None and self.now > self.actor_dies_at_s:
            self.actor_dies_at_s = None
            self.restarts["actor"] += 1
            self.actors["actor-0"] = PlayedActor("actor-0", 8, MemoryTransport(self.broker), self.driven)
        epochs = {name: actor.epoch for name, actor in self.actors.items()}
        interrupted = self.interrupted_at_s is not None and self.now > self.interrupted_at_s
        content = {"epochs": epochs, "restarts": dict(self.restarts), "interrupted": interrupted}
        orders = codec.encode(Orders(1, "scheduler", content))
        self.supervisor.publish(keys.control(RUN, "scheduler"), orders, retained=True)
        self.scheduler.step(self.now)
        for actor in self.actors.values():
            actor.step(self.now)
        self.others.step()

    def begin(self):
        self.epoch += 1
        self.fate.deeds.clear()
        self.fate.fatal = self.fatal.pop(0) if self.fatal else None
        self.transport, self.log = WatchedTransport(self.broker, self.fate), None
        self.log = WatchedLog(self.folder, self.fate)
        context = Context(CONFIG, RUN, "scheduler", "0", self.epoch, self.transport)
        self.scheduler = Scheduler(context, self.log, self.folder / "journal")

    def bury(self):
        """Close what a dead process would have had open."""
        self.transport.close()
        if self.log is not None:
            self.log.close()
        self.scheduler = None


@pytest.fixture
def fate(monkeypatch):
    """Fate of all schedulers of a test, with short ledgers."""
    watched = Fate()
    append, rebase = Journal.append, Journal.rebase

    def appended(self, records):
        try:
            watched("append")
        except KilledError:
            for log in self_folder(self).glob("*.log"):
                with log.open("ab") as file:
                    file.write(b"\x40\x00\x00\x00half a record")
            raise
        append(self, records)

    def rebased(self, *arguments, **options):
        watched("rebase")
        rebase(self, *arguments, **options)

    folders = {}

    def self_folder(ledger):
        return folders[id(ledger)]

    made = Journal.__init__

    def make(self, folder):
        folders[id(self)] = folder
        made(self, folder)

    monkeypatch.setattr(Journal, "__init__", make)
    monkeypatch.setattr(Journal, "append", appended)
    monkeypatch.setattr(Journal, "rebase", rebased)
    monkeypatch.setattr(journal, "COMPACT_RECORDS", 9)
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)  # a kill loses nothing that was written
    return watched


def check(play, summary, folder, driven_twice=0):
    """Check that a run has all that the undisturbed run has, each once."""
    lines = [json.loads(line) for line in (folder / "episodes.jsonl").read_text().splitlines()]
    assert [line["finished_as"] for line in lines] == list(range(1, 8))
    assert sorted(line["episode"] for line in lines) == list(range(1, 8))
    assert summary["episodes"] == 7 and summary["ended"] == "complete"
    assert summary["env_steps"] == sum(10 + number for number in range(1, 8))
    assert summary["outcomes"] == {"success": 5, "collision": 0, "timeout": 2}
    assert [(merge["episode"], merge["chosen"]) for merge in summary["merges"]] == [(4, "distilled"), (7, "distilled")]
    assert summary["restarts"].get("scheduler", 0) in (len(play.kills), len(play.kills) - 1)
    assert sum(play.driven[task] for task in play.driven if isinstance(task, int)) == 7 + driven_twice
    checkpoints = sorted(path.name for path in (folder / "checkpoints").iterdir())
    assert checkpoints[-1] == "00000007" and not any(name.startswith(".") for name in checkpoints)
    rows = [json.loads(line)["row"] for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert rows == list(range(len(rows)))


def undisturbed(folder, fate):
    play = Play(folder, fate)
    check(play, play.run(), folder)
    return list(fate.deeds)


def test_a_run_ends_the_same_wherever_its_scheduler_is_killed(tmp_path, fate):
    deeds = undisturbed(tmp_path / "whole", fate)
    writes = {"append", "rebase", "episode", "metrics", "begin_checkpoint", "summary", "events"}
    fatal = [number for number, deed in enumerate(deeds) if deed in writes or number % 6 == 0]
    killed, found = Counter(), Counter()
    for number in fatal:
        folder = tmp_path / str(number)
        play = Play(folder, fate, [number])
        check(play, play.run(), folder)
        killed.update(play.kills)
        found.update(json.loads(event.payload)["event"] for event in play.events.drain())
    assert killed.total() == len(fatal) and writes <= set(killed)
    assert found["scheduler_replaced"] >= len(fatal) - 3  # the others died before there was a ledger


@pytest.mark.parametrize("seed", range(6))
def test_a_run_ends_the_same_after_many_deaths_also_of_successors_and_of_actors(tmp_path, fate, seed):
    rng = np.random.default_rng(seed)
    fatal = [int(number) for number in rng.integers(1, 25, 12)]
    play = Play(tmp_path / "run", fate, fatal, actor_dies_at_s=0.5 if seed % 2 else None)
    summary = play.run()
    twice = sum(count - 1 for task, count in play.driven.items() if isinstance(task, int))
    check(play, summary, tmp_path / "run", driven_twice=twice)
    assert len(play.kills) > 6
    if seed % 2:
        assert summary["restarts"]["actor"] == 1
    else:
        assert max(play.driven.values()) == 1, "an episode was driven twice although its actor lived"


@pytest.mark.parametrize("fatal", [15, 30, 45, 60])
def test_an_interrupted_run_stays_interrupted(tmp_path, fate, fatal):
    play = Play(tmp_path / "run", fate, [fatal], interrupted_at_s=0.25)
    summary = play.run()
    lines = (tmp_path / "run" / "episodes.jsonl").read_text().splitlines()
    assert summary["ended"] == "interrupted" and play.kills
    assert summary["episodes"] == len(lines) == len({json.loads(line)["episode"] for line in lines}) < 7


def test_the_successor_of_a_scheduler_that_had_ended_the_run_changes_nothing(tmp_path, fate):
    play = Play(tmp_path / "run", fate)
    play.run()
    files = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*.json*")}
    play.begin()
    assert play.scheduler.step(play.now) is None
    assert {path: path.read_bytes() for path in (tmp_path / "run").rglob("*.json*")} == files
    assert "request" not in fate.deeds


def test_a_scheduler_that_wakes_after_it_was_replaced_writes_and_says_nothing(tmp_path, fate):
    play = Play(tmp_path / "run", fate)
    while len(play.driven) < 4:
        play.now += TICK_S
        play.advance()
    stopped, play.scheduler = play.scheduler, None
    play.begin()
    heard = Mailbox(2**24)
    play.supervisor.subscribe("zsdist/**", heard)
    with pytest.raises(RunError, match="belongs to a successor, of epoch 102"):
        stopped.step(play.now + 9.0)
    assert not heard
    check(play, play.run(), tmp_path / "run")


def test_a_ledger_from_which_an_entry_is_missing_is_not_believed(tmp_path):
    ledger = Ledger(tmp_path, 1)
    ledger.rebase({"first": 1})
    ledger.append([(1, b"one"), (2, b"two")])
    ledger.append([(3, b"three")])
    assert Ledger(tmp_path, 2).recover() == ({"first": 1}, [(1, b"one"), (2, b"two"), (3, b"three")])
    (log,) = tmp_path.glob("*.log")
    content = log.read_bytes()
    log.write_bytes(content[: len(content) // 3] + content[2 * (len(content) // 3) :])
    with pytest.raises(RunError, match="is damaged: an entry is missing"):
        Ledger(tmp_path, 3).recover()


def test_a_ledger_stays_small(tmp_path, fate):
    settings = parse({"run": {"actors": 2, "cars_per_actor": 2, "episodes": 10_000}, "merge": {"every_episodes": 0}})
    progress = RunProgress(settings, 1, lambda reason: None)
    ledger, most = Ledger(tmp_path / "ledger", 1), 0
    progress.issue("actor-0", 7)
    ledger.rebase(progress.base())
    for number in range(1, 301):
        progress.grant(10_000)
        path = [[x, 0.5 * x] for x in range(60)]
        records = (RECORD | {"actor": "actor-0", "episode": number, "outcome": "success", "steps": 60, "path": path},)
        frame = Records(EPISODES, "actor-0", 7, number - 1, number, False, records)
        progress.receive(frame, codec.encode(frame), 0.0)
        ledger.append(progress.take_entries())
        if ledger.wants_base:
            ledger.rebase(progress.base())
        most = max(most, ledger.nbytes)
    assert most < 16_384  # of some ten entries and the averages of the last episodes


def test_under_another_runner_the_actors_are_gone_and_an_unfinished_merge_begins_again(tmp_path):
    ledger, progress = Ledger(tmp_path, 1), RunProgress(CONFIG, 1, lambda reason: None)
    progress.begin_launch(1000)
    ledger.rebase(progress.base())
    for actor in ACTORS:
        progress.issue(actor, 7)
    progress.grant(4)
    progress.begin_merge(4, 1.5)
    progress.interrupted = True
    progress.totals.set_restarts({"hub": 1})
    progress.dismiss("actor-1", 7)
    ledger.append(progress.take_entries())

    same = RunProgress(CONFIG, 2, lambda reason: None)
    same.recover(Ledger(tmp_path, 2).recover())
    assert not same.begin_launch(1000) and same.base() == progress.base()
    assert same.epochs == {"actor-0": 7} and sorted(same.leases.holders) == [1, 2]

    assert same.begin_launch(2000)
    assert same.epochs == {} and same.leases.holders == {} and all(inbox.closed for inbox in same.inboxes.values())
    assert (same.stage, same.interrupted) == (Stage.TRAIN, False)
    assert (same.merge.index, same.merge.episode, same.merge.began_s, same.merge.drives) == (2, 4, None, 0)
    assert same.totals.restarts() == {"actor": 0, "hub": 1} and not same.totals.set_restarts({})
