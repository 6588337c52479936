import tempfile
from pathlib import Path

import numpy as np
from episode_records import RECORD

from zsdist.config import parse
from zsdist.roles.base import HEARTBEAT_S, Context
from zsdist.roles.scheduler.role import Scheduler, Stage
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Ack, Level, Weights
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, EVALUATION, Jobs, Orders, Records, State, WeightsMessage

RUN, ACTOR, EPOCH = "test", "actor-0", 7
SETTINGS = {
    "run": {"actors": 1, "cars_per_actor": 2, "episodes": 8, "checkpoint_every_episodes": 3},
    "merge": {"every_episodes": 4, "validation_scenes": 1, "drop_after_scenes": 1},
}
NO_MERGES = SETTINGS | {"merge": {"every_episodes": 0}}
DRIVE = RECORD | {"actor": ACTOR}
WEIGHTS = {"w": np.zeros(1, np.float32)}


class MemoryLog:
    """Run log that keeps the files of a run directory in memory."""

    def __init__(self):
        self.checkpoints, self.episodes, self.summaries = [], [], []

    def episode(self, record):
        self.episodes.append(record["episode"])

    def metrics(self, row):
        pass

    def begin_checkpoint(self, episodes, states, score):
        decoded = {name: codec.decode(payload) for name, payload in states.items()}
        return lambda: self.checkpoints.append((episodes, decoded))

    def summary(self, fields):
        self.summaries.append(fields)

    def wall_s(self):
        return 1.0


class Bench:
    """Scheduler at a memory transport; the test plays supervisor, actors, learners and replay."""

    def __init__(self, settings=SETTINGS, actors=(ACTOR,), restored=None, until=None):
        broker = MemoryBroker()
        self.others, self.log, self.now = MemoryTransport(broker), MemoryLog(), 0.0
        context = Context(parse(settings), RUN, "scheduler", "0", 5, MemoryTransport(broker))
        self._folder = tempfile.TemporaryDirectory()
        self.scheduler = Scheduler(context, self.log, Path(self._folder.name), restored)
        self.asked, self.published, self._frames, self.jobs = Mailbox(2**20), Mailbox(2**24), {}, {}
        self.epochs = dict.fromkeys(actors, EPOCH)
        for role in ("replay", "learner-high", "learner-low"):
            self.others.serve(keys.control(RUN, role), self.asked)
        for key in (keys.control(RUN, keys.ANY), keys.evaluation(RUN, keys.ANY)):
            self.others.subscribe(key, self.published)
        self.supervise(until=until)
        self.step()

    def supervise(self, interrupted=False, until=None):
        content = {"epochs": self.epochs, "restarts": {}, "interrupted": interrupted, "until": until}
        self.others.publish(keys.control(RUN, "scheduler"), codec.encode(Orders(1, "scheduler", content)))

    def step(self):
        self.now += 0.05
        self.scheduler.step(self.now)

    def orders(self):
        """Return the newest orders by role and drives by actor, after the next heartbeat."""
        self.now += HEARTBEAT_S
        self.step()
        newest = {}
        for message in self.published.drain():
            decoded = codec.decode(message.payload)
            if isinstance(decoded, Orders) and decoded.role != "scheduler":
                newest[decoded.role] = decoded.content
            elif isinstance(decoded, Jobs):
                newest[decoded.actor] = decoded.content["drives"]
                self.jobs[decoded.actor] = decoded.content
        return newest

    def leases(self):
        """Return the leases of each actor, after the next heartbeat."""
        self.orders()
        return {actor: self.jobs[actor]["leases"] for actor in self.epochs}

    def finish(self, *episodes, actor=ACTOR):
        for episode in episodes:
            self._push(EPISODES, actor, {"episode": episode})
            self.step()

    def drive(self, candidate, outcome, scene=0, merge=1, actor=ACTOR):
        about = {"scene_index": scene, "merge": merge, "candidate": candidate, "outcome": outcome}
        self._push(EVALUATION, actor, about)

    def close(self, actor=ACTOR):
        """Send the last frames of an actor's epoch."""
        for stream in (EPISODES, EVALUATION):
            self._push(stream, actor, None)
        self.step()

    def report(self, about):
        """Send a record of an episode as it is."""
        self._push(EPISODES, ACTOR, about)

    def _push(self, stream, actor, about):
        sequence, produced = self._frames.get((stream, actor), (0, 0))
        records = () if about is None else (DRIVE | {"actor": actor} | about,)
        self._frames[stream, actor] = sequence + 1, produced + len(records)
        epoch = self.epochs[actor]
        frame = Records(stream, actor, epoch, sequence, produced + len(records), about is None, records)
        key = keys.episodes(RUN, actor, epoch) if stream == EPISODES else keys.evaluation(RUN, actor)
        self.others.publish(key, codec.encode(frame))

    def promote(self, merge=1):
        for level in Level:
            message = WeightsMessage(2, merge, "0" * 64, 0.0, Weights(level, 9, WEIGHTS))
            self.others.publish(keys.weights(RUN, level), codec.encode(message))
        self.step()

    def answer(self, requests, **about):
        self.reply(requests, **about)
        self.step()

    def reply(self, requests, merge=0, frames_expected=0):
        """Send the states of all roles, of the learners as after a number of merges."""
        for request in requests:
            role = codec.decode(request.payload).role
            level_replay = {"open": frames_expected, "books": {"stored": merge}}
            learner = {"version": 1, "updates": 1, "merge": merge, "sha256": "0" * 64}
            meta = {"high": level_replay, "low": level_replay} if role == "replay" else learner
            request.reply(codec.encode(State(role, meta, {})))

    @property
    def merging(self):
        return self.scheduler.progress.merge is not None


def merged(answered_before_the_merge, promoted=True):
    """Bring a scheduler to a merge at episode 4, with the checkpoint of episode 3 requested and not written."""
    bench = Bench()
    bench.finish(1, 2, 3)
    early = bench.asked.drain()
    assert len(early) == 3
    if answered_before_the_merge:
        bench.reply(early[:2])
    bench.finish(4)
    assert bench.merging
    if not answered_before_the_merge:
        bench.answer(early[:2])
    bench.drive("recent", "collision")
    bench.drive("distilled", "success")
    bench.step()
    if promoted:
        bench.promote()
    return bench


def test_the_checkpoint_of_a_merge_holds_what_was_promoted_whatever_was_asked_before():
    for answered_before_the_merge in (True, False):
        bench = merged(answered_before_the_merge)
        assert bench.log.checkpoints == []
        bench.answer(bench.asked.drain(), merge=1)
        ((episodes, states),) = bench.log.checkpoints
        assert episodes == 4 and states["scheduler"].meta["merges"][0]["chosen"] == "distilled"
        assert [states[f"learner-{level}"].meta["merge"] for level in Level] == [1, 1]
        assert states["replay"].meta["low"]["books"] == {"stored": 1}
        assert bench.scheduler.stage is Stage.TRAIN


def test_training_goes_on_beside_a_merge_and_not_past_the_next_one():
    bench = Bench(SETTINGS | {"run": SETTINGS["run"] | {"episodes": 20}})
    bench.finish(1, 2, 3, 4)
    assert bench.merging
    orders = bench.orders()
    assert orders["learner"]["learning"]
    assert (bench.leases(), orders["actor"]["leasing"]) == ({ACTOR: [5, 6]}, True)
    bench.finish(5, 6, 7, 8)
    orders = bench.orders()
    assert (bench.leases(), orders["actor"]["leasing"]) == ({ACTOR: []}, False)
    assert (orders["learner"]["learning"], orders["learner"]["merge"]) == (True, 1)
    decide(bench)
    bench.promote()
    orders = bench.orders()
    assert orders["learner"]["merge"] == 2  # at once
    assert (bench.leases(), orders["actor"]["leasing"]) == ({ACTOR: [9, 10]}, True)
    assert [merge["episode"] for merge in bench.scheduler.progress.totals.merges] == [4]


def decide(bench, merge=1):
    bench.drive("recent", "collision", merge=merge)
    bench.drive("distilled", "success", merge=merge)
    bench.step()


def test_a_merge_costs_what_its_drives_took():
    bench = Bench()
    bench.finish(1, 2, 3, 4)
    began_s = bench.now
    bench.now += 7.0
    decide(bench)
    bench.promote()
    (merge,) = bench.scheduler.progress.totals.merges
    assert merge["cost"] == {"seconds": round(bench.now - began_s, 3), "drives": 2, "actions": 6}


def test_a_checkpoint_in_a_merge_knows_nothing_of_it_and_a_run_resumed_from_it_merges_at_once():
    bench = Bench()
    bench.finish(1, 2, 3)
    bench.answer(bench.asked.drain())
    bench.finish(4, 5, 6)
    assert bench.merging
    bench.answer(bench.asked.drain())
    (_, (episodes, states)) = bench.log.checkpoints
    assert (episodes, states["scheduler"].meta["merges"]) == (6, [])
    resumed = Bench(restored=states["scheduler"])
    orders = resumed.orders()
    assert (orders["learner"]["merge"], orders["learner"]["candidates"]) == (2, ["recent", "distilled"])
    assert resumed.leases() == {ACTOR: [7, 8]}
    decide(resumed, merge=2)
    resumed.promote(merge=2)
    assert [merge["episode"] for merge in resumed.scheduler.progress.totals.merges] == [4]


def test_no_checkpoint_is_made_while_a_winner_is_promoted():
    bench = Bench()
    bench.finish(1, 2, 3, 4)
    decide(bench)
    early = bench.asked.drain()
    bench.finish(5, 6, 7)
    bench.answer(early, merge=1)  # of one learner that has promoted, and one that has not
    assert bench.log.checkpoints == [] and not bench.asked
    bench.promote()
    bench.answer(bench.asked.drain(), merge=1)
    ((episodes, _),) = bench.log.checkpoints
    assert episodes == 7


def test_learning_stops_with_the_last_episode_so_that_the_run_ends_with_what_was_compared():
    bench = Bench()
    bench.finish(1, 2, 3, 4)
    decide(bench)
    bench.promote()
    bench.finish(5, 6, 7)
    assert bench.orders()["learner"]["learning"]
    bench.finish(8)
    orders = bench.orders()["learner"]
    assert (orders["merge"], orders["learning"]) == (2, False)


def test_merges_that_were_switched_on_late_are_held_once():
    bench = Bench(NO_MERGES | {"run": SETTINGS["run"] | {"episodes": 40}})
    bench.finish(*range(1, 12))
    resumed = Bench(SETTINGS | {"run": SETTINGS["run"] | {"episodes": 40}}, restored=bench.scheduler.state())
    assert resumed.merging
    decide(resumed)
    resumed.promote()
    assert not resumed.merging
    assert [merge["episode"] for merge in resumed.scheduler.progress.totals.merges] == [8]


def test_the_drives_of_a_merge_go_to_all_actors_and_stop_when_it_is_decided():
    bench = Bench(SETTINGS | {"merge": SETTINGS["merge"] | {"validation_scenes": 2}}, actors=("actor-0", "actor-1"))
    bench.finish(1, 2)
    bench.finish(3, 4, actor="actor-1")
    orders = bench.orders()
    assert (orders["learner"]["merge"], orders["learner"]["chosen"]) == (1, "")
    assert orders["actor-0"] == [["recent", 0], ["distilled", 1]]
    assert orders["actor-1"] == [["distilled", 0], ["recent", 1]]
    bench.drive("recent", "success", scene=0)
    assert bench.orders()["actor-0"] == [["distilled", 1]]
    for scene in (0, 1):
        bench.drive("distilled", "collision", scene=scene)
    bench.drive("recent", "success", scene=1)
    orders = bench.orders()
    assert (orders["actor-0"], orders["actor-1"]) == ([], [])
    assert (orders["learner"]["driven"], orders["learner"]["chosen"]) == (4, "recent")


def ended(bench):
    """Play the rest of a run whose actors have been ordered to close."""
    assert bench.orders()["actor"]["closing"]
    assert bench.log.summaries == [] and not bench.asked
    bench.close()
    bench.answer(bench.asked.drain())
    return bench.log.summaries


def test_a_checkpoint_is_made_in_time_however_few_episodes_have_finished():
    bench = Bench(SETTINGS | {"run": SETTINGS["run"] | {"checkpoint_every_s": 60.0}})
    for expected in ([0], [0, 1]):
        bench.now += 58.0
        bench.step()
        assert not bench.asked
        bench.now += 3.0
        bench.step()
        requests = bench.asked.drain()
        assert bench.scheduler.statistics()["states_awaited"] == "replay learner-high learner-low"
        bench.answer(requests)
        assert [episodes for episodes, _ in bench.log.checkpoints] == expected
        assert "states_awaited" not in bench.scheduler.statistics()
        bench.finish(1)


def test_a_run_ends_with_a_checkpoint_and_a_summary_once_all_epochs_are_closed():
    bench = Bench(NO_MERGES)
    bench.finish(*range(1, 8))
    bench.asked.drain()  # of a checkpoint on the way
    bench.finish(8)
    (summary,) = ended(bench)
    assert (summary["ended"], summary["episodes"], summary["env_steps"]) == ("complete", 8, 24)
    assert [episodes for episodes, _ in bench.log.checkpoints] == [8]
    assert bench.log.episodes == list(range(1, 9))
    assert bench.scheduler.finished and bench.scheduler.stage is Stage.DONE


def test_the_last_orders_are_to_stop():
    bench = Bench(NO_MERGES)
    bench.finish(*range(1, 9))
    bench.asked.drain()
    before = bench.orders()
    ended(bench)
    last = {}
    for message in bench.published.drain():
        decoded = codec.decode(message.payload)
        if isinstance(decoded, Orders):
            last[decoded.role] = decoded.content
    for role in ("replay", "learner"):
        assert last[role]["stop"] and not before[role]["stop"]


def test_the_last_checkpoint_waits_until_the_replay_expects_no_frame():
    bench = Bench(NO_MERGES)
    bench.finish(*range(1, 8))
    bench.asked.drain()
    bench.finish(8)
    bench.orders()
    bench.close()
    bench.answer(bench.asked.drain(), frames_expected=1)
    assert bench.log.checkpoints == [] and not bench.asked
    bench.orders()  # a heartbeat later
    (again,) = bench.asked.drain()
    assert codec.decode(again.payload).role == "replay"
    bench.answer([again])
    assert [episodes for episodes, _ in bench.log.checkpoints] == [8]
    assert bench.log.summaries[0]["ended"] == "complete"


def test_an_interrupted_run_cuts_its_episodes_and_saves():
    bench = Bench()
    bench.finish(1, 2)
    bench.supervise(interrupted=True)
    assert bench.orders()["actor"]["cut"]
    (summary,) = ended(bench)
    assert (summary["ended"], summary["episodes"], summary["merges"]) == ("interrupted", 2, [])


def test_an_interrupted_comparison_is_given_up():
    bench = Bench()
    bench.finish(1, 2, 3, 4)
    bench.drive("recent", "success")
    bench.supervise(interrupted=True)
    assert bench.orders()[ACTOR] == []
    bench.asked.drain()  # of the checkpoint of episode 3
    (summary,) = ended(bench)
    assert (summary["ended"], summary["episodes"], summary["merges"]) == ("interrupted", 4, [])


def test_an_interruption_while_the_winner_is_promoted_ends_the_run_after_the_merge():
    bench = merged(answered_before_the_merge=False, promoted=False)
    bench.supervise(interrupted=True)
    bench.step()
    assert bench.scheduler.stage is Stage.TRAIN
    bench.promote()
    bench.asked.drain()  # of the checkpoint of the merge, which the last one replaces
    (summary,) = ended(bench)
    assert (summary["ended"], len(summary["merges"])) == ("interrupted", 1)
    assert len(bench.log.checkpoints) == 1


def test_a_resumed_run_leases_what_is_left_and_merges_at_the_next_multiple():
    bench = merged(answered_before_the_merge=False)
    bench.answer(bench.asked.drain(), merge=1)
    ((_, states),) = bench.log.checkpoints
    resumed = Bench(restored=states["scheduler"])
    assert resumed.leases() == {ACTOR: [5, 6]}
    resumed.finish(5, 6, 7, 8)
    assert resumed.merging
    assert resumed.orders()["learner"]["candidates"] == ["recent", "distilled", "best"]


def test_a_scheduler_that_works_until_a_number_closes_there_and_saves_once_and_by_no_clock():
    bench = Bench(SETTINGS | {"run": SETTINGS["run"] | {"checkpoint_every_s": 60.0}}, until=3)
    bench.finish(1)
    assert bench.leases() == {ACTOR: [2, 3]}
    bench.now += 61.0
    bench.finish(2, 3)
    assert not bench.asked
    assert ended(bench) == []
    ((episodes, states),) = bench.log.checkpoints
    assert (episodes, states["scheduler"].meta["time_s"]) == (3, round(bench.now, 3))
    assert bench.scheduler.finished


def test_a_scheduler_that_works_until_a_merge_saves_once_after_it_and_its_successor_goes_on_behind_it():
    bench = Bench(until=4)
    bench.finish(1, 2, 3, 4)
    bench.drive("recent", "collision")
    bench.drive("distilled", "success")
    bench.step()
    bench.promote()
    assert ended(bench) == []
    ((episodes, states),) = bench.log.checkpoints
    assert (episodes, states["scheduler"].meta["merges"][0]["chosen"]) == (4, "distilled")
    assert Bench(restored=states["scheduler"], until=6).leases() == {ACTOR: [5, 6]}


def test_few_episodes_until_a_number_are_dealt_out_to_all_actors():
    bench = Bench(actors=("actor-0", "actor-1", "actor-2"), until=4)
    leases = bench.leases()
    assert [len(leases[f"actor-{number}"]) for number in range(3)] == [2, 1, 1]


def test_a_scheduler_with_nothing_to_do_saves_at_once():
    bench = Bench(until=0)
    assert bench.leases() == {ACTOR: []}
    assert ended(bench) == []
    assert [episodes for episodes, _ in bench.log.checkpoints] == [0]


def test_the_episodes_of_a_replaced_actor_are_leased_to_its_successor():
    bench = Bench(NO_MERGES)
    assert bench.leases() == {ACTOR: [1, 2]}
    bench.finish(1)
    bench.epochs[ACTOR] = EPOCH + 1
    bench.supervise()
    assert bench.leases() == {ACTOR: [2, 3]} and bench.jobs[ACTOR]["epoch"] == EPOCH + 1


def test_an_actor_is_told_why_its_record_is_refused():
    bench, acks = Bench(NO_MERGES), Mailbox(2**20)
    bench.others.subscribe(keys.ack(RUN, ACTOR), acks)
    bench.report({"episode": 1, "return": 1e38})
    for _ in range(10):
        bench.step()
    found = [codec.decode(message.payload, expect=Ack) for message in acks.drain()]
    assert any("return is 1e+38" in ack.refused for ack in found if ack.stream == EPISODES)
    assert not any(ack.refused for ack in found if ack.stream == EVALUATION)
