import numpy as np

from zsdist.config import parse
from zsdist.roles.base import Context
from zsdist.roles.scheduler.role import Scheduler, Stage
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level, Weights
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, EVALUATION, Candidate, Orders, Records, State, WeightsMessage

RUN, ACTOR, EPOCH = "test", "actor-0", 7
SETTINGS = {
    "run": {"actors": 1, "cars_per_actor": 2, "episodes": 8, "checkpoint_every_episodes": 3},
    "merge": {"every_episodes": 4, "validation_scenes": 1, "drop_after_scenes": 1},
}
DRIVE = {
    "actor": ACTOR,
    "scene": "made up",
    "outcome": "success",
    "steps": 3,
    "return": 1.0,
    "epsilon": 0.5,
    "shielded": True,
    "path_m": 1.0,
    "start": [0.0, 0.0],
    "goal": [1.0, 1.0],
    "path": [[0.0, 0.0]],
}
WEIGHTS = {"w": np.zeros(1, np.float32)}


class Books:
    """The ledger of a run directory, in memory."""

    def __init__(self):
        self.checkpoints = []

    def episode(self, record):
        pass

    def metrics(self, row):
        pass

    def checkpoint(self, episodes, states):
        self.checkpoints.append((episodes, states))

    def wall_s(self):
        return 1.0


class Bench:
    """A scheduler, with the actor, the learners and the replay played by the test."""

    def __init__(self):
        broker = MemoryBroker()
        self.others, self.books, self.now = MemoryTransport(broker), Books(), 0.0
        self.scheduler = Scheduler(
            Context(parse(SETTINGS), RUN, "scheduler", "0", 5, MemoryTransport(broker)), self.books
        )
        self.asked, self._frames = Mailbox(2**20), {EPISODES: 0, EVALUATION: 0}
        for role in ("replay", "learner-high", "learner-low"):
            self.others.serve(keys.control(RUN, role), self.asked)
        content = {"epochs": {ACTOR: EPOCH}, "restarts": {}, "interrupted": False}
        self.others.publish(keys.control(RUN, "scheduler"), codec.encode(Orders(1, "scheduler", content)))
        self.step()

    def step(self):
        self.now += 0.05
        self.scheduler.step(self.now)

    def finish(self, episode):
        self._push(EPISODES, keys.episodes(RUN, ACTOR, EPOCH), {"episode": episode})

    def drive(self, candidate, outcome):
        about = {"scene_index": 0, "merge": 1, "candidate": candidate, "outcome": outcome}
        self._push(EVALUATION, keys.evaluation(RUN, ACTOR), about)

    def _push(self, stream, key, about):
        count = self._frames[stream]
        self._frames[stream] += 1
        self.others.publish(key, codec.encode(Records(stream, ACTOR, EPOCH, count, count + 1, False, (DRIVE | about,))))

    def offer(self):
        for level in Level:
            for name in ("recent", "distilled"):
                message = Candidate(2, level, 1, name, WEIGHTS)
                self.others.publish(keys.candidate(RUN, level, f"1-{name}"), codec.encode(message))

    def promote(self):
        for level in Level:
            message = WeightsMessage(2, 1, "0" * 64, 0.0, Weights(level, 9, WEIGHTS))
            self.others.publish(keys.weights(RUN, level), codec.encode(message))

    def answer(self, requests, merge):
        """The roles tell their states, the learners as of after so many merges."""
        for request in requests:
            role = codec.decode(request.payload).role
            level_replay = {"open": 1, "books": {"stored": merge}}
            learner = {"version": 1, "updates": 1, "merge": merge, "sha256": "0" * 64}
            meta = {"high": level_replay, "low": level_replay} if role == "replay" else learner
            request.reply(codec.encode(State(role, meta, {})))


def merged(answered_before_the_barrier):
    """A merge at episode 4, when the checkpoint of episode 3 had been asked for, but not written."""
    bench = Bench()
    for episode in (1, 2, 3):
        bench.finish(episode)
        bench.step()
    early = bench.asked.drain()
    assert len(early) == 3
    if answered_before_the_barrier:
        bench.answer(early, merge=0)
    bench.finish(4)
    bench.step()
    assert bench.scheduler.stage is Stage.MERGE
    bench.offer()
    bench.step()
    if not answered_before_the_barrier:
        bench.answer(early, merge=0)
    bench.drive("recent", "collision")
    bench.drive("distilled", "success")
    bench.step()
    bench.promote()
    bench.step()
    return bench


def test_the_checkpoint_of_a_merge_holds_what_was_promoted_whatever_was_asked_before():
    for answered_before_the_barrier in (True, False):
        bench = merged(answered_before_the_barrier)
        assert bench.books.checkpoints == []
        bench.answer(bench.asked.drain(), merge=1)
        bench.step()
        ((episodes, states),) = bench.books.checkpoints
        assert episodes == 4 and states["scheduler"].meta["merges"][0]["chosen"] == "distilled"
        assert [states[f"learner-{level}"].meta["merge"] for level in Level] == [1, 1]
        assert states["replay"].meta["low"]["books"] == {"stored": 1}
        assert bench.scheduler.stage is Stage.TRAIN
