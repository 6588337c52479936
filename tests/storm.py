"""Actors and a replay with a journal over a bad network, on a virtual clock; each of them dies from time to time.

The state of every transition encodes its actor, epoch, trajectory and position in it. In the end, the content of the
buffer is compared with the transitions that the actors know to be acknowledged.
"""

import threading
from collections import Counter
from pathlib import Path

import numpy as np
from faulty import Faults, FaultyTransport

from zsdist.config import parse
from zsdist.protocol.outbox import Outbox
from zsdist.roles.base import Context
from zsdist.roles.replay.level_replay import Shape
from zsdist.roles.replay.role import Replay
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import NO_GUIDE, Level, Trajectory
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders, Push, SampleReply, SampleRequest

RUN, STEP_S = "storm", 0.02
ACTORS, ACTIONS, FEATURES = 3, 3, 4
TRAJECTORIES = 16  # in the last epoch of each actor; earlier epochs are cut off
PATIENCE_S = 400.0
CONFIGS = {
    shards: parse(
        {
            "run": {"actors": ACTORS, "cars_per_actor": 1},
            "low": {"min_size": 8, "updates_per_insert": 0.5},
            "replay": {"shards": shards, "size_initial": 4000, "size_min": 1000, "size_max": 4000},
        }
    )
    for shards in (1, 2)
}


def trajectory(actor: int, epoch: int, number: int, length: int) -> Trajectory:
    """Trajectory whose states identify actor, epoch, trajectory and position."""
    states = np.zeros((length + 1, FEATURES), np.float32)
    states[:, 0], states[:, 1], states[:, 2], states[:, 3] = actor, epoch, number, np.arange(length + 1)
    return Trajectory(
        Level.LOW,
        states,
        np.zeros(length, np.uint8),
        np.arange(length, dtype=np.float32),
        np.full(length, 0.9, np.float32),
        np.arange(1, length + 1, dtype=np.uint16),
        np.ones((length + 1, ACTIONS), bool),
        np.full(length, NO_GUIDE, np.int8),
        np.zeros(length, np.uint8),
        0,
    )


class Driver:
    """Outbox of one actor, and the trajectories that it was offered."""

    def __init__(self, index: int, epoch: int, transport: FaultyTransport) -> None:
        self.index, self.epoch, self.transport = index, epoch, transport
        self.name = f"actor-{index}"
        self.offered: list[tuple[int, int]] = []  # number and length of each trajectory
        self.totals: list[int] = []  # running total at each frame sent
        self.box = Mailbox(2**20)
        self.outbox = Outbox(
            Level.LOW, self.name, epoch, window_frames=6, resend_after_s=0.25, give_up_after_s=60, make_frame=Push
        )
        transport.subscribe(keys.ack(RUN, self.name), self.box)

    @property
    def confirmed(self) -> int:
        """Number of transitions in acknowledged frames."""
        acknowledged = len(self.totals) - self.outbox.statistics()["unacknowledged_frames"]
        return self.totals[acknowledged - 1] if acknowledged else 0

    def step(self, rng: np.random.Generator, now: float) -> None:
        for message in self.box.drain():
            self.outbox.on_ack(codec.decode(message.payload), now)
        length = int(rng.integers(1, 9))
        if len(self.offered) < TRAJECTORIES and rng.random() < 0.5 and self.outbox.reserve(length):
            self.outbox.offer([trajectory(self.index, self.epoch, len(self.offered), length)])
            self.offered.append((len(self.offered), length))
            if len(self.offered) == TRAJECTORIES:
                self.outbox.close()
        for frame in self.outbox.poll(now):
            if frame.sequence == len(self.totals):
                self.totals.append(frame.produced)
            self.transport.publish(keys.push(RUN, Level.LOW, self.name, self.epoch), codec.encode(frame))


class Storm:
    """Simulation of one seed with a replay of `shards` shards; `ride` runs it, `check` checks the end."""

    def __init__(self, seed: int, folder: Path, shards: int = 1) -> None:
        self.rng = np.random.default_rng(seed)
        shares = self.rng.random(4) * (0.4, 0.3, 0.5, 0.5)
        self.faults = Faults(drop=shares[0], repeat=shares[1], delay=shares[2], reorder=shares[3], delay_s=0.6)
        self.broker, self.seed, self.folder = MemoryBroker(), seed, folder
        self.now, self.epoch = 0.0, 0
        self.transports: list[FaultyTransport] = []
        self.scheduler, self.learner = self.connect(), self.connect()
        self.batches = Mailbox(2**22)
        self.deaths = {"replay": 0, "actor": 0, "partition": 0}
        self.sampled = 0
        self.dead: list[Driver] = []
        self.drivers = [Driver(index, self.next_epoch(), self.connect()) for index in range(ACTORS)]
        self.config = CONFIGS[shards]
        self.replays: list[Replay] = []
        for index in range(shards):
            self.begin_replay(index)

    @property
    def recovered(self) -> int:
        """Number of frames that the current shards have read from journals."""
        return sum(replay.recovered for replay in self.replays)

    def connect(self) -> FaultyTransport:
        transport = FaultyTransport(MemoryTransport(self.broker), self.seed + len(self.transports), self.faults)
        self.transports.append(transport)
        return transport

    def next_epoch(self) -> int:
        self.epoch += 1
        return self.epoch

    def begin_replay(self, index: int) -> None:
        context = Context(self.config, RUN, "replay", str(index), self.next_epoch(), self.connect(), threading.Event())
        shapes = {Level.LOW: Shape(FEATURES, ACTIONS)}
        self.replays[index : index + 1] = [Replay(context, shapes, self.folder / str(index))]

    def ride(self) -> None:
        """Run until the last epoch of every actor is closed and acknowledged."""
        while not all(driver.outbox.drained for driver in self.drivers):
            assert self.now < PATIENCE_S, f"seed {self.seed} does not end"
            self.now += STEP_S
            self.strike()
            self.publish_orders()
            self.request_batches()
            for driver in self.drivers:
                driver.step(self.rng, self.now)
            for replay in self.replays:
                replay.step(self.now)
            for transport in self.transports:
                transport.tick(self.now)

    def strike(self) -> None:
        """Kill an actor or a replay from time to time, but seldom enough for the run to end."""
        luck = self.rng.random()
        if luck < 0.03 and self.deaths["replay"] < 4:
            self.deaths["replay"] += 1
            index = int(self.rng.integers(len(self.replays)))
            self.replays[index].transport.close()  # unsent messages are lost; the journal's file stays
            self.tear(index)
            self.begin_replay(index)
        elif luck < 0.05 and self.deaths["actor"] < 4:
            self.deaths["actor"] += 1
            victim = int(self.rng.integers(ACTORS))
            self.dead.append(self.drivers[victim])
            self.drivers[victim].transport.close()
            self.drivers[victim] = Driver(victim, self.next_epoch(), self.connect())
        elif luck < 0.07 and self.deaths["partition"] < 3:
            self.deaths["partition"] += 1
            partitioned = self.transports[int(self.rng.integers(len(self.transports)))]
            partitioned.faults = Faults(drop=1.0)  # all its messages are lost for a while
        elif luck > 0.9:
            for transport in self.transports:
                transport.faults = self.faults

    def tear(self, index: int) -> None:
        """Append bytes of an unfinished record, as if the replay had died while writing."""
        if self.rng.random() < 0.5:
            log = max((self.folder / str(index)).glob("*/*.log"))
            with log.open("ab") as file:
                file.write(bytes(self.rng.integers(0, 256, int(self.rng.integers(1, 40)), np.uint8)))

    def publish_orders(self) -> None:
        content = {
            "epochs": {driver.name: driver.epoch for driver in self.drivers},
            "buffer_size": 4000,
            "batch_size": 16,
            "stop": False,
        }
        key = keys.control(RUN, "replay")
        self.scheduler.publish(key, codec.encode(Orders(1, "replay", content)), retained=True)

    def request_batches(self) -> None:
        request = codec.encode(SampleRequest(1, Level.LOW, 0))
        for index in range(len(self.replays)):
            self.learner.request(keys.sample(RUN, Level.LOW, index), request, self.batches, timeout_s=1.0)
        for message in self.batches.drain():
            reply = codec.decode(message.payload)
            self.sampled += isinstance(reply, SampleReply) and reply.batch is not None

    def check(self) -> None:
        """Check that nothing is lost, duplicated, mixed or in the wrong shard, and that counts and buffers agree."""
        level_replays = [replay.level_replays[Level.LOW] for replay in self.replays]
        rings = []
        for replay, level_replay in zip(self.replays, level_replays, strict=True):
            level_replay.buffer.check_valid()
            rings.append(level_replay.buffer.state())
            actors = set(rings[-1]["states"][:, 0].astype(int).tolist())
            assert all(replay.shard.owns(f"actor-{actor}") for actor in actors)
        rows = {name: np.concatenate([ring[name] for ring in rings]) for name in ("states", "next_states", "rewards")}
        states, following = rows["states"], rows["next_states"]
        assert (states[:, :3] == following[:, :3]).all(), "a transition joins two trajectories"
        assert (following[:, 3] == states[:, 3] + 1).all()
        assert (rows["rewards"] == states[:, 3]).all(), "a transition is put together from two"
        held = [tuple(row) for row in states.astype(int).tolist()]
        assert len(set(held)) == len(held), "a transition is there twice"
        for driver in self.drivers:
            for number, length in driver.offered:
                expected = {(driver.index, driver.epoch, number, place) for place in range(length)}
                assert expected <= set(held), f"{driver.name} lost transitions of trajectory {number}"
        for driver in self.dead:
            mine = [row for row in held if row[:2] == (driver.index, driver.epoch)]
            assert driver.confirmed <= len(mine) <= driver.outbox.produced, "acknowledged transitions are not stored"
        books = Counter()
        for level_replay in level_replays:
            books.update(level_replay.counts())
        assert books["produced"] == books["stored"] == len(held) and books["rejected"] == 0
