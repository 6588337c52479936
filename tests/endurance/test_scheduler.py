"""A scheduler that writes a run directory, through 1,000 merges, 100,000 episodes, dead actors and resumes."""

import time

import episode_records
import numpy as np
import pytest
from endurance.conftest import DAY_S

from zsdist.config import parse
from zsdist.roles.base import Context
from zsdist.roles.scheduler.role import Scheduler, Stage
from zsdist.run import directory
from zsdist.run.directory import RunDirectory
from zsdist.run.scene_schedule import SceneSchedule
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level, Weights
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, EVALUATION, Candidate, Jobs, Orders, Records, State, WeightsMessage

VISION = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
RUN, ACTORS, CARS = "month", 4, 4
ROLES = ("replay", "learner-high", "learner-low")
WEIGHTS = {"w": np.zeros(1, np.float32)}
STANDSTILL_ROUNDS = 50
RECORD = episode_records.RECORD | {"steps": 60, "path": [[0.0, 0.0]] * 5}


class FakeRun:
    """All of a run but its scheduler: actors, learners and replay answer at once, and nothing is simulated."""

    def __init__(self, folder, settings):
        self.folder, self.settings, self.starts, self.now = folder, settings, 0, 0.0
        self.schedule = SceneSchedule(settings)
        self.start(None)

    def start(self, restored):
        """Start a scheduler, with new epochs for all actors."""
        self.starts += 1
        self.broker = MemoryBroker()
        self.others = MemoryTransport(self.broker)
        log = RunDirectory(self.folder, VISION)
        context = Context(self.settings, RUN, "scheduler", "0", self.starts, MemoryTransport(self.broker))
        self.scheduler = Scheduler(context, log, self.folder / "journal" / str(self.starts), restored)
        self.asked, self.orders, self.stats = Mailbox(2**24), Mailbox(2**28), {}
        for role in ROLES:
            self.others.serve(keys.control(RUN, role), self.asked)
        for key in (keys.control(RUN, keys.ANY), keys.evaluation(RUN, keys.ANY)):
            self.others.subscribe(key, self.orders)
        self.epochs = {f"actor-{index}": self.starts * 10**6 for index in range(ACTORS)}
        self.frames, self.offered, self.promoted, self.closed, self.newest = {}, 0, 0, set(), {}
        self.supervise()

    def resume(self):
        settings, states = directory.reopen(self.folder)
        directory.rewind(self.folder, settings, states)
        self.start(states["scheduler"])

    def supervise(self, interrupted=False):
        content = {"epochs": self.epochs, "restarts": {}, "interrupted": interrupted}
        self.others.publish(keys.control(RUN, "scheduler"), codec.encode(Orders(1, "scheduler", content)))

    def kill(self, actor):
        """Replace an actor: its next incarnation begins with new frames."""
        self.epochs[actor] += 1
        self.frames = {key: value for key, value in self.frames.items() if key[1] != actor}
        self.supervise()

    def round(self, passed_s):
        """Let time pass, and everybody do all that they have been ordered to do."""
        self.now += passed_s
        self.scheduler.step(self.now)
        for message in self.orders.drain():
            decoded = codec.decode(message.payload)
            if isinstance(decoded, Jobs):
                self.newest[decoded.actor] = decoded.content
            elif isinstance(decoded, Orders):
                self.newest[decoded.role] = decoded.content
        self._learn(self.newest["learner"])
        for actor in self.epochs:
            self._act(actor, self.newest["actor"], self.newest[actor])
        for request in self.asked.drain():
            self._answer(request)

    def _learn(self, orders):
        merge = orders["merge"]
        if self.offered < merge:
            self.offered = merge
            for level in Level:
                for name in orders["candidates"]:
                    key = keys.candidate(RUN, level, name)
                    self.others.publish(key, codec.encode(Candidate(1, level, merge, name, WEIGHTS)))
        if orders["chosen"] and self.promoted < merge:
            self.promoted = merge
            for level in Level:
                message = WeightsMessage(1, merge, "0" * 64, 0.0, Weights(level, merge, WEIGHTS))
                self.others.publish(keys.weights(RUN, level), codec.encode(message))

    def _act(self, actor, orders, jobs):
        if orders["closing"]:
            if actor not in self.closed:
                self.closed.add(actor)
                self._push(EPISODES, actor, [], closes=True)
                self._push(EVALUATION, actor, [], closes=True)
            return
        leases = jobs["leases"]
        self._push(EPISODES, actor, [RECORD | {"actor": actor, "episode": number} for number in leases])
        about = {"actor": actor, "merge": jobs["merge"]}
        drives = [RECORD | about | {"candidate": name, "scene_index": index} for name, index in jobs["drives"]]
        if drives:
            self.schedule.validation(jobs["merge"], jobs["merge"] % 20)
        self._push(EVALUATION, actor, drives)

    def _push(self, stream, actor, records, closes=False):
        if not records and not closes:
            return
        sequence, produced = self.frames.get((stream, actor), (0, 0))
        produced += len(records)
        self.frames[stream, actor] = sequence + 1, produced
        epoch = self.epochs[actor]
        key = keys.episodes(RUN, actor, epoch) if stream == EPISODES else keys.evaluation(RUN, actor)
        frame = Records(stream, actor, epoch, sequence, produced, closes, tuple(records))
        self.others.publish(key, codec.encode(frame))

    def _answer(self, request):
        role = codec.decode(request.payload).role
        level = {"open": 0, "books": {"stored": 1}}
        learner = {"version": 1, "updates": 1, "merge": self.promoted, "sha256": "0" * 64}
        meta = {"high": level, "low": level} if role == "replay" else learner
        request.reply(codec.encode(State(role, meta, {})))


@pytest.mark.timeout(3600)
def test_a_month_of_episodes_and_merges_neither_stops_nor_grows(tmp_path, span, growth, report):
    settings = parse(
        {
            "run": {
                "actors": ACTORS,
                "cars_per_actor": CARS,
                "episodes": span.episodes,
                "checkpoint_every_episodes": 500,
                "checkpoint_every_s": 1e9,  # one a minute would take hours
            },
            "merge": {"every_episodes": 100},
            "scenes": {"train": ["iid"]},
        }
    )
    folder, began_s = directory.create(tmp_path / "run", settings), time.monotonic()
    run = FakeRun(folder, settings)
    a_round_s = DAY_S * span.days / span.episodes * ACTORS * CARS
    rounds, seen, quarter = 0, None, 0
    while run.scheduler.stage is not Stage.DONE:
        progress = run.scheduler.finished_episodes, len(run.scheduler.progress.totals.merges), run.scheduler.stage
        rounds = 0 if progress != seen else rounds + 1
        seen = progress
        assert rounds < STANDSTILL_ROUNDS, f"nothing happens after {progress}"
        training = run.scheduler.stage is Stage.TRAIN
        run.round(a_round_s if training else 1.0)
        if run.now > quarter * DAY_S / 4:
            quarter += 1
            if quarter > 1:
                growth.note(run.now / DAY_S)  # not at the very beginning, when all is loaded
            run.kill(f"actor-{quarter % ACTORS}")
            if quarter % 40 == 3:
                run.resume()
    growth.note(run.now / DAY_S)
    refused = {name: value for name, value in run.scheduler.snapshot.of("scheduler")["0"].items() if "rejected" in name}
    lines = (folder / "episodes.jsonl").read_text().splitlines()
    report(
        days=run.now / DAY_S,
        episodes=run.scheduler.finished_episodes,
        merges=len(run.scheduler.progress.totals.merges),
        starts=run.starts,
        memory_mib_a_day=growth.mib_a_day,
        took_s=time.monotonic() - began_s,
    )
    assert run.scheduler.finished_episodes == len(lines) == span.episodes
    assert len(run.scheduler.progress.totals.merges) >= span.merges
    assert not refused and not run.scheduler.snapshot.malformed
    assert growth.mib_a_day < 1
