"""A scheduler goes on with its work while its answers are read and its checkpoint is written."""

from concurrent.futures import Future

import pytest
from episode_records import RECORD

from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.roles.base import HEARTBEAT_S, Context
from zsdist.roles.scheduler.role import Scheduler, Stage
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Ack
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, Jobs, Orders, Records, State

RUN, ACTOR, EPOCH = "test", "actor-0", 7
SETTINGS = {"run": {"actors": 1, "cars_per_actor": 2, "episodes": 40, "checkpoint_every_episodes": 3}}
DRIVE = RECORD | {"actor": ACTOR}


class SlowThread:
    """Background whose functions run when the test says so, in their order."""

    def __init__(self):
        self.waiting = []

    def __call__(self, function):
        future = Future()
        self.waiting.append((function, future))
        return future

    def run_next(self):
        function, future = self.waiting.pop(0)
        try:
            future.set_result(function())
        except Exception as error:
            future.set_exception(error)


class Log:
    """Run log that keeps what was written, and can fail."""

    def __init__(self):
        self.checkpoints, self.summaries, self.error = [], [], None

    def begin_checkpoint(self, episodes, states, score):
        def write():
            if self.error is not None:
                raise self.error
            self.checkpoints.append(episodes)

        return write

    def episode(self, record):
        pass

    def metrics(self, row):
        pass

    def summary(self, fields):
        self.summaries.append(fields)

    def wall_s(self):
        return 1.0


class Bench:
    """Scheduler with a slow background; the test plays all other roles."""

    def __init__(self, folder):
        broker, self.now, self.log, self.thread = MemoryBroker(), 0.0, Log(), SlowThread()
        self.others = MemoryTransport(broker)
        settings = parse(SETTINGS | {"merge": {"every_episodes": 0}})
        context = Context(settings, RUN, "scheduler", "0", 5, MemoryTransport(broker), background=self.thread)
        self.scheduler = Scheduler(context, self.log, folder)
        self.asked, self.jobs, self.acks = Mailbox(2**20), Mailbox(2**24), Mailbox(2**20)
        for role in ("replay", "learner-high", "learner-low"):
            self.others.serve(keys.control(RUN, role), self.asked)
        self.others.subscribe(keys.evaluation(RUN, ACTOR), self.jobs)
        self.others.subscribe(keys.ack(RUN, ACTOR), self.acks)
        self.finished = 0
        self.supervise()

    def supervise(self, interrupted=False):
        content = {"epochs": {ACTOR: EPOCH}, "restarts": {}, "interrupted": interrupted}
        self.others.publish(keys.control(RUN, "scheduler"), codec.encode(Orders(1, "scheduler", content)))
        self.step()

    def step(self):
        self.now += HEARTBEAT_S
        self.scheduler.step(self.now)

    def finish_next(self, closes=False):
        """Finish the next episode; return the number of acknowledged records, and the leases."""
        records = () if closes else (DRIVE | {"episode": self.finished + 1},)
        frame = Records(EPISODES, ACTOR, EPOCH, self.finished, self.finished + len(records), closes, records)
        self.finished += len(records)
        self.others.publish(keys.episodes(RUN, ACTOR, EPOCH), codec.encode(frame))
        self.step()
        acks = [codec.decode(message.payload, expect=Ack) for message in self.acks.drain()]
        jobs = codec.decode(self.jobs.drain()[-1].payload, expect=Jobs)
        return max(ack.received for ack in acks if ack.stream == EPISODES), jobs.content["leases"]

    def answer(self):
        for request in self.asked.drain():
            role = codec.decode(request.payload).role
            level_replay = {"open": 0, "books": {"stored": 0}}
            learner = {"version": 1, "updates": 1, "merge": 0, "sha256": "0" * 64}
            meta = {"high": level_replay, "low": level_replay} if role == "replay" else learner
            request.reply(codec.encode(State(role, meta, {})))
        self.step()


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def test_records_are_acknowledged_and_episodes_leased_while_answers_are_read_and_a_checkpoint_is_written(bench):
    for _ in range(3):
        bench.finish_next()
    bench.answer()
    assert len(bench.thread.waiting) == 3  # answers to read
    for episode in (4, 5):
        assert bench.finish_next() == (episode, [episode + 1, episode + 2])
    for _ in range(3):
        bench.thread.run_next()
    bench.step()
    assert len(bench.thread.waiting) == 1  # a checkpoint to write
    for episode in range(6, 16):
        assert bench.finish_next() == (episode, [episode + 1, episode + 2])
    assert bench.log.checkpoints == [] and len(bench.thread.waiting) == 1 and not bench.asked
    bench.thread.run_next()
    bench.step()
    assert bench.log.checkpoints == [5]
    bench.step()
    assert len(bench.asked) == 3  # the next one, which was due meanwhile


def test_a_disk_that_does_not_take_the_checkpoint_ends_the_scheduler(bench):
    for _ in range(3):
        bench.finish_next()
    bench.answer()
    for _ in range(3):
        bench.thread.run_next()
    bench.step()
    bench.log.error = RunError("the disk is full")
    bench.thread.run_next()
    with pytest.raises(RunError, match="the disk is full"):
        bench.step()


def test_an_interrupted_run_waits_for_a_checkpoint_under_way_and_ends_with_one_of_its_own(bench):
    for _ in range(3):
        bench.finish_next()
    bench.answer()
    for _ in range(3):
        bench.thread.run_next()
    bench.step()
    bench.supervise(interrupted=True)
    bench.finish_next(closes=True)
    evaluation = Records("evaluation", ACTOR, EPOCH, 0, 0, True, ())
    bench.others.publish(keys.evaluation(RUN, ACTOR), codec.encode(evaluation))
    bench.step()
    assert bench.scheduler.stage is Stage.SAVING and not bench.asked
    bench.thread.run_next()
    bench.step()
    assert bench.log.checkpoints == [3] and bench.log.summaries == []
    bench.answer()
    while bench.thread.waiting:
        assert bench.log.summaries == []
        bench.thread.run_next()
        bench.step()
    assert bench.log.checkpoints == [3, 3] and len(bench.log.summaries) == 1
    assert bench.scheduler.finished
