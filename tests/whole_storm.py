"""All roles of a run over a bad network, on virtual clocks that jump; each of them dies from time to time.

Roles are built as for processes of their own, with their files on the disk; only the cars are instant. The state of
every transition names its actor, the actor's epoch, and its place. An observer sees every message that is not lost. In
the end, what it saw acknowledged is compared with what is stored, and everything that was counted with everything else.
"""

import json
import threading
from collections import Counter
from pathlib import Path

import numpy as np
from faulty import Faults, FaultyTransport
from flow import InstantCar, NoPictures, NoScenes
from rehearsal import SEEN

from zsdist.config import parse
from zsdist.roles.actor import Actor
from zsdist.roles.base import HEARTBEAT_S, Role
from zsdist.roles.replay import shards
from zsdist.roles.shapes import SHAPES
from zsdist.run import directory, program
from zsdist.run.program import RoleSpec, RunSpec
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import NO_GUIDE, Ack, Level, Trajectory
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders, Push, WeightsMessage

TICK_S = 0.02
EPISODES, CARS = 240, 2
START_S, PATIENCE_S = 1e9, 900.0
LEAVE_WITHIN_S = 5.0
CLOCK_S = 3600.0
MORTAL = ("scheduler", "learner", shards.ROLE, "actor")
MOST_DEATHS = 4  # of each kind
RUN = {"actors": 2, "cars_per_actor": CARS, "episodes": EPISODES, "checkpoint_every_episodes": 60}
LEVEL = {"hidden": [4], "min_size": 8, "updates_per_insert": 0.1}
CONFIGS = {
    count: parse(
        {
            "run": RUN,
            "low": LEVEL,
            "high": LEVEL,
            "merge": {"every_episodes": 80, "validation_scenes": 2, "distil_updates": 1},
            "replay": {"shards": count, "adaptive": False, "batch_initial": 16},
        }
    )
    for count in (1, 2)
}


class NumberedCar(InstantCar):
    """Instant car whose transitions name their actor, its epoch, and their place."""

    def __init__(self, actor: int, epoch: int, car: int) -> None:
        super().__init__()
        self._name, self._count = (actor, epoch, car), 0

    def advance(self, view, q):
        super().advance(view, q)
        if self.over and self.trains and self._ready:
            self._count += 1
            self._ready = [numbered(level, (*self._name, self._count)) for level in Level]


def numbered(level: Level, name: tuple[int, ...]) -> Trajectory:
    """Trajectory of one transition whose first features are its name."""
    shape = SHAPES[level]
    states = np.zeros((2, shape.state_size), np.float32)
    states[:, : len(name)] = name
    return Trajectory(
        level=level,
        states=states,
        actions=np.zeros(1, np.uint8),
        rewards=np.ones(1, np.float32),
        discounts=np.zeros(1, np.float32),
        successors=np.ones(1, np.uint16),
        masks=np.ones((2, shape.actions), bool),
        guides=np.full(1, NO_GUIDE, np.int8),
        behaviours=np.zeros(1, np.uint8),
        weight_version=1,
    )


def names_in(states: np.ndarray) -> list[tuple[int, ...]]:
    """Names of the transitions with these states."""
    return [tuple(row) for row in states[:, :4].astype(int).tolist()]


class Living:
    """Role that lives: its incarnation, its transport, its clock, and when it is due."""

    def __init__(self, role_spec: RoleSpec, transport: FaultyTransport, clock_s: float) -> None:
        self.role_spec, self.transport, self.clock_s = role_spec, transport, clock_s
        self.wake = threading.Event()
        self.role: Role | None = None
        self.due_s: float | None = 0.0

    def step(self, now: float) -> None:
        """Let it work if it is due."""
        if self.due_s is not None and (self.due_s <= now or self.wake.is_set()):
            self.wake.clear()
            due_s = self.role.step(now + self.clock_s)
            self.due_s = None if due_s is None else due_s - self.clock_s


class Observer:
    """Listener that loses nothing of what is not lost on its way to everyone.

    Attributes:
        pushed: names of the transitions in each frame, by level, actor, epoch and number.
        received: number of acknowledged frames, by level, actor and epoch.
        versions: hash of each version of weights, by level and version.
        contradictions: versions that were published with different weights.
    """

    def __init__(self, broker: MemoryBroker, run: str) -> None:
        self.pushed: dict[tuple, list] = {}
        self.received: Counter = Counter()
        self.versions: dict[tuple[str, int], str] = {}
        self.contradictions: list[tuple[str, int]] = []
        self._box = Mailbox(2**30)
        self._transport = MemoryTransport(broker)
        for pattern in (
            keys.push(run, keys.ANY, keys.ANY, keys.ANY),
            keys.ack(run, keys.ANY),
            keys.weights(run, keys.ANY),
        ):
            self._transport.subscribe(pattern, self._box)

    def listen(self) -> None:
        """Take in what was sent."""
        for message in self._box.drain():
            match codec.decode(message.payload):
                case Push() as push:
                    stream = (str(push.stream), push.actor, push.epoch, push.sequence)
                    self.pushed[stream] = [name for part in push.trajectories for name in names_in(part.states[:-1])]
                case Ack() as ack:
                    stream = (str(ack.stream), ack.actor, ack.epoch)
                    self.received[stream] = max(self.received[stream], ack.received)
                case WeightsMessage() as message:
                    version = (str(message.weights.level), message.weights.version)
                    if self.versions.setdefault(version, message.sha256) != message.sha256:
                        self.contradictions.append(version)

    def acknowledged(self, level: str) -> set[tuple[int, ...]]:
        """Names of all transitions of a level in acknowledged frames."""
        streams = [stream for stream in self.received if stream[0] == level]
        return {
            name
            for stream in streams
            for sequence in range(self.received[stream])
            for name in self.pushed[(*stream, sequence)]
        }


class WholeStorm:
    """Simulation of one seed; `ride` runs it, `check` checks the end."""

    def __init__(self, seed: int, folder: Path, count: int = 1) -> None:
        self.seed, self.folder = seed, folder / "run"
        self.rng = np.random.default_rng(seed)
        shares = self.rng.random(4) * (0.3, 0.3, 0.4, 0.4)
        self.faults = Faults(drop=shares[0], repeat=shares[1], delay=shares[2], reorder=shares[3], delay_s=0.6)
        self.config = CONFIGS[count]
        directory.create(self.folder, self.config)
        self.spec = RunSpec(self.config, "storm", self.folder, {}, SEEN)
        self.broker, self.now, self._epoch = MemoryBroker(), START_S, 0
        self.observer = Observer(self.broker, self.spec.run)
        self.deaths: Counter = Counter(dict.fromkeys(MORTAL, 0))
        self._transports = 0
        self._supervisor, self._next_orders_s = self._connect(), START_S
        epochs = [self._next_epoch() for _ in range(program.role_count(self.config))]
        self.living: dict[str, Living] = {}
        for role_spec in program.roles(self.config, epochs):
            self._begin(role_spec)

    def ride(self) -> None:
        """Run until the scheduler has ended, and the others as long as a supervisor leaves them."""
        ended_s = None
        while ended_s is None or self.now < ended_s + LEAVE_WITHIN_S:
            if ended_s is None and self.living["scheduler-0"].due_s is None:
                ended_s = self.now
            assert self.now < START_S + PATIENCE_S, f"seed {self.seed} does not end: {self._ages()}"
            self.now += TICK_S
            self._strike()
            if self.now >= self._next_orders_s:
                self._next_orders_s = self.now + HEARTBEAT_S
                self._order()
            for living in self.living.values():
                living.step(self.now)
            for transport in [self._supervisor, *(living.transport for living in self.living.values())]:
                transport.tick(self.now)
            self.observer.listen()

    def _strike(self) -> None:
        """Kill a role from time to time, cut another one off, or end all that disturbs."""
        luck = self.rng.random()
        if luck < 0.02:
            self._kill(MORTAL[int(self.rng.integers(len(MORTAL)))])
        elif luck < 0.03:
            names = sorted(self.living)
            self.living[names[int(self.rng.integers(len(names)))]].transport.faults = Faults(drop=1.0)
        elif luck > 0.95:
            for living in self.living.values():
                living.transport.faults = self.faults

    def _kill(self, kind: str) -> None:
        names = [name for name, living in self.living.items() if living.role_spec.role == kind]
        victim = self.living[names[int(self.rng.integers(len(names)))]]
        # The supervisor ends with the scheduler: nobody is replaced afterwards.
        if self.deaths[kind] == MOST_DEATHS or victim.due_s is None or self.living["scheduler-0"].due_s is None:
            return
        self.deaths[kind] += 1
        victim.transport.close()
        self._begin(RoleSpec(kind, victim.role_spec.id, self._next_epoch()))

    def _begin(self, role_spec: RoleSpec) -> None:
        clock_s = float(self.rng.choice((-CLOCK_S, 0.0, CLOCK_S)))  # each process reads the clock once, at its start
        living = Living(role_spec, self._connect(role_spec.name), clock_s)
        if role_spec.role == "actor":
            context = self.spec.context(role_spec, living.transport, living.wake)
            cars = [NumberedCar(int(role_spec.id), role_spec.epoch, car) for car in range(CARS)]
            living.role = Actor(context, cars, NoPictures(), NoScenes())
        else:
            living.role = self.spec.build(role_spec, living.transport, living.wake)
        self.living[role_spec.name] = living

    def _connect(self, name: str = "supervisor") -> FaultyTransport:
        self._transports += 1
        inner = MemoryTransport(self.broker, name)
        return FaultyTransport(inner, 1000 * self.seed + self._transports, self.faults)

    def _next_epoch(self) -> int:
        self._epoch += 1
        return self._epoch

    def _order(self) -> None:
        specs = [living.role_spec for living in self.living.values()]
        content = program.supervision(specs, interrupted=False, restarts=dict(self.deaths))
        orders = codec.encode(Orders(1, "scheduler", content))
        self._supervisor.publish(keys.control(self.spec.run, "scheduler"), orders, retained=True)

    def _ages(self) -> dict[str, str]:
        return {name: "ended" if living.due_s is None else "lives" for name, living in self.living.items()}

    def check(self) -> None:
        """Check that nothing is lost, doubled or counted twice, and that all accounts agree."""
        summary = json.loads((self.folder / "summary.json").read_text())
        lines = [json.loads(line) for line in (self.folder / "episodes.jsonl").read_text().splitlines()]
        assert [line["finished_as"] for line in lines] == list(range(1, EPISODES + 1))
        assert sorted(line["episode"] for line in lines) == list(range(1, EPISODES + 1)), "an episode counts twice"
        assert summary["episodes"] == EPISODES and sum(summary["outcomes"].values()) == EPISODES
        assert summary["env_steps"] == sum(line["steps"] for line in lines)
        assert [merge["episode"] for merge in summary["merges"]] == list(range(80, EPISODES + 1, 80))
        assert self.observer.contradictions == [], "a version of weights was published twice"
        replays = [living.role for living in self.living.values() if living.role_spec.role == shards.ROLE]
        for level in Level:
            held = [
                name
                for replay in replays
                for name in names_in(replay.level_replays[level].buffer.state()["states"].astype(np.float32))
            ]
            assert len(set(held)) == len(held), "a transition is stored twice"
            missing = self.observer.acknowledged(level.value) - set(held)
            assert not missing, f"{len(missing)} acknowledged transitions are lost"
            counts = summary["transitions"][level.value]
            assert counts["produced"] == counts["stored"] == len(held) and counts["rejected"] == 0
            assert summary["learner_updates"][level.value] <= counts["stored"] * LEVEL["updates_per_insert"] + 1
