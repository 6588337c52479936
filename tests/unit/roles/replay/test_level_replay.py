"""Credit: whatever the sizes of a run, its cars end their options and its learners get their batches."""

import random

import pytest
from flow import SHAPES, Flow

from zsdist.config import parse
from zsdist.roles.actor_outboxes import ActorOutboxes, CreditAccount
from zsdist.roles.replay.level_replay import LevelReplay, credit_to_end_options
from zsdist.roles.replay.shards import ReplayShard
from zsdist.types import Ack, Level


def settings(actors, cars=1, shards=1, ratio=0.25, min_size=128, option=24, size=10_000):
    level = {"updates_per_insert": ratio, "min_size": min_size, "hidden": [4]}
    return parse(
        {
            "run": {"actors": actors, "cars_per_actor": cars},
            "agent": {"option_max_steps": option},
            "replay": {"shards": shards, "size_initial": size, "size_min": min(size, 1000), "batch_initial": 16},
            "high": level,
            "low": level,
        }
    )


class Credit:
    """Real limiters and accounts without messages; a car's transitions arrive as soon as its option has ended."""

    def __init__(self, config, folder):
        self.option = config.agent.option_max_steps
        self.shards = [ReplayShard.of(config, index) for index in range(config.replay.shards)]
        self.levels = [
            {level: LevelReplay(level, SHAPES[level], config, shard, 1, folder / shard.name / level) for level in Level}
            for shard in self.shards
        ]
        names = [f"actor-{index}" for index in range(config.run.actors)]
        self.owner = {name: index for index, shard in enumerate(self.shards) for name in names if shard.owns(name)}
        self.outboxes = {name: ActorOutboxes("run", name, 1, config.transport) for name in names}
        self.cars = [(name, CreditAccount()) for name in names for _ in range(config.run.cars_per_actor)]
        self.ended = [0] * len(self.cars)
        for name in names:
            for level_replay in self.levels[self.owner[name]].values():
                level_replay.issue(name, 1)

    def acknowledge(self):
        """Give every outbox its present credit."""
        for name, outboxes in self.outboxes.items():
            for level, level_replay in self.levels[self.owner[name]].items():
                outboxes.on_ack(Ack(1, name, 1, level, 0, level_replay.credit(name, 1)), 0.0)

    def act(self, index):
        """Let a car act until it has no credit or its option has ended; return whether it acted."""
        name, account = self.cars[index]
        acted = False
        while self.outboxes[name].reserve(account):
            acted = True
            if account.pending[Level.LOW] < self.option:
                account.count_step()
                continue
            for level, level_replay in self.levels[self.owner[name]].items():
                account.reserved[level] -= self.option
                account.pending[level] = 0
                level_replay.limiter.count_inserts(f"{name}/1", self.option)
            self.ended[index] += 1
            break
        return acted

    def learn(self):
        """Take all batches that may be taken; return whether there was one."""
        limiters = [level_replay.limiter for levels in self.levels for level_replay in levels.values()]
        taken = False
        for limiter in limiters:
            while limiter.allowed:
                limiter.take_batch()
                taken = True
        return taken


@pytest.mark.parametrize(
    "sizes",
    [
        {"actors": 257},
        {"actors": 300, "min_size": 1},
        {"actors": 4096, "option": 2},
        {"actors": 300, "cars": 4, "option": 6},
        {"actors": 2, "cars": 256, "option": 3},
        {"actors": 16, "shards": 16, "cars": 3},
        {"actors": 300, "shards": 7, "option": 6},
        {"actors": 40, "ratio": 1e-6},
        {"actors": 40, "ratio": 20.0},
        {"actors": 40, "min_size": 100, "size": 20},
        {"actors": 300, "min_size": 3000, "size": 50},
        {"actors": 3, "option": 400},
    ],
    ids=str,
)
def test_every_car_ends_its_options_in_any_order_of_events(sizes, tmp_path):
    credit, order = Credit(settings(**sizes), tmp_path), random.Random(0)
    for _ in range(200):
        indices = list(range(len(credit.cars)))
        order.shuffle(indices)
        credit.acknowledge()
        acted = [credit.act(index) for index in indices if credit.ended[index] < 3]
        if not acted:
            break
        assert any([*acted, credit.learn()]), f"{credit.ended.count(0)} cars stand in their first option"
    assert min(credit.ended) >= 3


def test_actors_beyond_the_band_go_on_over_real_messages(tmp_path):
    flow = Flow(settings(260, ratio=0.02, option=6), tmp_path)
    assert flow.drive(options=3, give_up_s=30.0) == 3
    assert all(learner.updates for learner in flow.learners)


def test_a_resumed_run_with_other_actors_goes_on(tmp_path):
    before = Credit(settings(8, option=4), tmp_path / "before")
    while min(before.ended) < 5:
        before.acknowledge()
        for index in range(len(before.cars)):
            before.act(index)
        before.learn()
    after = Credit(settings(300, option=4), tmp_path / "after")
    for level in Level:
        after.levels[0][level].limiter.restore(before.levels[0][level].limiter.state(), same_run=False)
        for name in after.outboxes:
            after.levels[0][level].limiter.open(f"{name}/1")
    while min(after.ended) < 2:
        after.acknowledge()
        assert any([after.act(index) for index in range(len(after.cars))] + [after.learn()])


def test_an_option_is_no_longer_than_an_episode():
    config = parse({"agent": {"option_max_steps": 10**9}, "sim": {"max_steps": 500}, "run": {"cars_per_actor": 4}})
    assert credit_to_end_options(config) == 501 * 4


@pytest.mark.parametrize("dies", [False, True])
def test_an_actor_that_has_left_gives_its_credit_back_and_may_return(tmp_path, dies):
    config = settings(actors=2, min_size=1)

    def replay():
        return LevelReplay(Level.LOW, SHAPES[Level.LOW], config, ReplayShard.of(config, 0), 1, tmp_path)

    level_replay = replay()
    level_replay.recover(None)
    for actor in ("actor-0", "actor-7"):
        level_replay.issue(actor, 1)
    for _ in range(2):  # the orders come again and again
        level_replay.dismiss("actor-7", 1)
        level_replay.dismiss("actor-7", 0)
    level_replay.write_journal(1.0)
    if dies:
        level_replay = replay()
        level_replay.recover(None)
        level_replay.dismiss("actor-7", 1)
    assert level_replay.inbox.open_streams() == [("actor-0", 1)]
    assert not level_replay.issue("actor-7", 1)
    assert level_replay.issue("actor-7", 2) and ("actor-7", 2) in level_replay.inbox.open_streams()
    assert set(level_replay.limiter.state()["streams"]) == {"actor-0/1", "actor-7/2"}
