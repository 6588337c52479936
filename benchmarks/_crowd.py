"""Many clients at one hub: each actor has a connection of its own, and hub, shards and learner have a process each.

Processes are forked before any of them opens a connection, so that a thousand clients need no thousand interpreters.
What each part spends is its own CPU time, which does not depend on what else the machine does; rates and delays do.
"""

import itertools
import json
import multiprocessing as mp
import os
import resource
import struct
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
from wire import LENGTH, make_trajectory

from zsdist.agent.features import LOW_ACTIONS, LOW_STATE_SIZE
from zsdist.config import Config, parse
from zsdist.protocol.outbox import Outbox
from zsdist.roles.base import Context
from zsdist.roles.replay.role import Replay
from zsdist.roles.replay.shards import ROLE
from zsdist.roles.shapes import Shape
from zsdist.transport.base import Mailbox
from zsdist.transport.zenoh import ZenohHub, ZenohTransport
from zsdist.types import Level
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders, Push, SampleReply, SampleRequest

RUN = "crowd"
WEIGHTS_BYTES = 136_000  # of both levels' networks in half precision
WEIGHTS_EVERY_S = 1.0
UPDATES_PER_INSERT = 1 / 32
LEASES = 64  # distinct trajectories that an actor pushes in turn
IDLE_S = 0.02
FLOAT = struct.Struct("<d")
CONTEXT = mp.get_context("fork")


@dataclass(frozen=True)
class Case:
    """What is measured at once.

    Attributes:
        clients: number of actors, each with a connection of its own.
        processes: number of processes that they share.
        shards: number of shards of the replay.
        rate: transitions that each actor pushes in a second.
        seconds: duration of the measurement.
    """

    clients: int
    processes: int
    shards: int = 1
    rate: float = 100.0
    seconds: float = 10.0

    @property
    def config(self) -> Config:
        """Settings of a run with so many actors and shards."""
        sections = {"run": {"actors": self.clients}, "replay": {"shards": self.shards}}
        return parse({**sections, "low": {"updates_per_insert": UPDATES_PER_INSERT}})


@dataclass
class Counts:
    """What a part has done so far; all are sums."""

    cpu_s: float = 0.0
    pushes: int = 0
    push_bytes: int = 0
    transitions: int = 0
    acks: int = 0
    resent: int = 0
    weights: int = 0
    batches: int = 0
    ack_s: list[float] = field(default_factory=list)  # of a sample of frames
    weights_s: list[float] = field(default_factory=list)

    def since(self, before: "Counts") -> "Counts":
        """Return the difference to an earlier state."""
        later, earlier = asdict(self), asdict(before)
        return Counts(**{k: v[len(earlier[k]) :] if isinstance(v, list) else v - earlier[k] for k, v in later.items()})


class Part:
    """A part in a process of its own, which answers `read` with its counts and ends after `end`."""

    def __init__(self, work: Any, *arguments: Any) -> None:
        self._here, there = CONTEXT.Pipe()
        self._process: BaseProcess = CONTEXT.Process(target=_serve, args=(there, work, *arguments), daemon=True)
        self._process.start()
        there.close()

    def wait(self) -> None:
        """Wait until the part is connected."""
        if self._here.recv() != "ready":
            raise SystemExit("a part of the benchmark could not start")

    def ask(self) -> None:
        """Ask for the counts, which `answer` returns."""
        self._here.send("read")

    def answer(self) -> Counts:
        """Return the counts that were asked for."""
        return self._here.recv()

    def end(self) -> None:
        """End the process."""
        self._here.close()
        self._process.join(10)
        self._process.kill()


def _serve(pipe: Connection, work: Any, *arguments: Any) -> None:
    """Do the steps of a part until its pipe is closed, and answer in between."""
    counts = Counts()
    steps: Iterator[None] = work(counts, *arguments)
    next(steps)  # connects
    pipe.send("ready")
    try:
        while True:
            next(steps)
            while pipe.poll():
                pipe.recv()
                usage = resource.getrusage(resource.RUSAGE_SELF)
                counts.cpu_s = usage.ru_utime + usage.ru_stime
                pipe.send(counts)
    except (EOFError, OSError):
        os._exit(0)  # zenoh's threads need not be waited for


def _hub(counts: Counts, endpoint: str) -> Iterator[None]:
    with ZenohHub(endpoint, ports_tried=1):
        while True:
            yield
            time.sleep(IDLE_S)


def _shard(counts: Counts, case: Case, endpoint: str, index: int, folder: str) -> Iterator[None]:
    wake = threading.Event()
    transport = ZenohTransport(endpoint)
    context = Context(case.config, RUN, ROLE, str(index), 1 + index, transport, wake)
    shapes = {Level.LOW: Shape(LOW_STATE_SIZE, LOW_ACTIONS)}
    (journals := Path(folder) / str(index)).mkdir()
    replay = Replay(context, shapes, journals)
    while True:
        yield
        wake_s = replay.step(time.time())
        level_replay = replay.level_replays[Level.LOW]
        counts.transitions = level_replay.stored
        if wake_s is not None and wake.wait(min(IDLE_S, max(0.0, wake_s - time.time()))):
            wake.clear()


def _learner(counts: Counts, case: Case, endpoint: str) -> Iterator[None]:
    """Take batches as a learner does, and publish weights; also give the scheduler's orders to the shards."""
    wake, transport, config = threading.Event(), ZenohTransport(endpoint), case.config
    box = Mailbox(config.transport.mailbox_bytes, wake.set)
    orders = {
        "epochs": {f"actor-{index}": index + 1 for index in range(case.clients)},
        "buffer_size": config.replay.size_initial,
        "batch_size": config.replay.batch_initial,
        "stop": False,
    }
    transport.publish(keys.control(RUN, ROLE), codec.encode(Orders(1, ROLE, orders)), retained=True)
    asked, updates, next_s = [0] * case.shards, [0] * case.shards, 0.0
    noise = os.urandom(WEIGHTS_BYTES)
    boxes = [Mailbox(config.transport.mailbox_bytes, wake.set) for _ in range(case.shards)]
    while True:
        yield
        for shard, box in enumerate(boxes):
            for message in box.drain():
                reply = codec.decode(message.payload)
                asked[shard] -= 1
                if isinstance(reply, SampleReply) and reply.batch is not None:
                    updates[shard] += reply.batches
                    counts.batches += reply.batches
            while asked[shard] < 2:
                request = codec.encode(SampleRequest(1, Level.LOW, updates[shard], 1))
                transport.request(keys.sample(RUN, Level.LOW, shard), request, box, timeout_s=10.0)
                asked[shard] += 1
        if time.monotonic() > next_s:
            next_s = time.monotonic() + WEIGHTS_EVERY_S
            transport.publish(keys.weights(RUN, Level.LOW), FLOAT.pack(time.time()) + noise, retained=True)
            counts.weights += 1
        if wake.wait(IDLE_S):
            wake.clear()


class _Client:
    """An actor without a car, with a connection of its own."""

    def __init__(self, case: Case, endpoint: str, index: int, wake: threading.Event) -> None:
        settings, self.name = case.config.transport, f"actor-{index}"
        self.outbox = Outbox(
            Level.LOW,
            self.name,
            index + 1,
            window_frames=settings.window_frames,
            resend_after_s=settings.resend_after_s,
            give_up_after_s=3600.0,
            make_frame=Push,
        )
        self.transport = ZenohTransport(endpoint, connect_timeout_s=60.0)
        self.acks, self.weights = (Mailbox(settings.mailbox_bytes, wake.set) for _ in range(2))
        self.transport.subscribe(keys.ack(RUN, self.name), self.acks)
        self.transport.subscribe(keys.weights(RUN, Level.LOW), self.weights, retained=True)
        self.due_s = time.monotonic() + LENGTH / case.rate * (index % 16) / 16
        self.every_s = LENGTH / case.rate
        self.sent_s: dict[int, float] = {}

    def step(self, counts: Counts, trajectories: Iterator[Any]) -> None:
        """Take what has arrived, and push what is due."""
        now = time.time()
        for message in self.acks.drain():
            ack = codec.decode(message.payload)
            self.outbox.on_ack(ack, now)
            counts.acks += 1
            for sequence in [number for number in self.sent_s if number < ack.received]:
                counts.ack_s.append(now - self.sent_s.pop(sequence))
        for message in self.weights.drain():
            counts.weights += 1
            counts.weights_s.append(now - FLOAT.unpack_from(message.payload)[0])
        clock_s = time.monotonic()
        while clock_s >= self.due_s and self.outbox.reserve(LENGTH):
            self.due_s = max(self.due_s + self.every_s, clock_s - 1.0)
            self.outbox.offer([next(trajectories)])
        resent = self.outbox.statistics()["resent_frames"]
        for frame in self.outbox.poll(now):
            payload = codec.encode(frame)
            self.sent_s.setdefault(frame.sequence, now)
            self.transport.publish(keys.push(RUN, Level.LOW, self.name, frame.epoch), payload)
            counts.pushes += 1
            counts.push_bytes += len(payload)
        counts.resent += self.outbox.statistics()["resent_frames"] - resent


def _clients(counts: Counts, case: Case, endpoint: str, first: int) -> Iterator[None]:
    rng, wake = np.random.default_rng(first), threading.Event()
    made = itertools.cycle([make_trajectory(rng, LOW_STATE_SIZE) for _ in range(LEASES)])
    clients = [_Client(case, endpoint, index, wake) for index in range(first, case.clients, case.processes)]
    while True:
        yield
        for client in clients:
            client.step(counts, made)
        if wake.wait(IDLE_S):
            wake.clear()


def measure(case: Case, endpoint: str) -> dict[str, Any]:
    """Return the figures of one case, as a flat JSON object."""
    folder = tempfile.TemporaryDirectory()
    parts: dict[str, list[Part]] = {"hub": [Part(_hub, endpoint)]}
    try:
        _wait(parts["hub"])
        parts["shard"] = [Part(_shard, case, endpoint, index, folder.name) for index in range(case.shards)]
        _wait(parts["shard"])
        parts["learner"] = [Part(_learner, case, endpoint)]
        _wait(parts["learner"])
        parts["client"] = [Part(_clients, case, endpoint, first) for first in range(case.processes)]
        _wait(parts["client"])
        began = _read(parts)  # after the first second of connecting
        time.sleep(min(2.0, case.seconds / 4))
        began, began_s = _read(parts), time.monotonic()
        time.sleep(case.seconds)
        ended, wall_s = _read(parts), time.monotonic() - began_s
    finally:
        for part in itertools.chain.from_iterable(parts.values()):
            part.end()
        folder.cleanup()
    spent = {
        kind: [after.since(before) for before, after in zip(began[kind], ended[kind], strict=True)] for kind in parts
    }
    return (
        asdict(case) | {"wall_s": wall_s, "load": os.getloadavg()[0], "cores": os.cpu_count()} | _figures(spent, wall_s)
    )


def _wait(parts: list[Part]) -> None:
    for part in parts:
        part.wait()


def _read(parts: dict[str, list[Part]]) -> dict[str, list[Counts]]:
    for part in itertools.chain.from_iterable(parts.values()):
        part.ask()
    return {kind: [part.answer() for part in several] for kind, several in parts.items()}


def _figures(spent: dict[str, list[Counts]], wall_s: float) -> dict[str, float]:
    clients, shards = spent["client"], spent["shard"]

    def rate(several: list[Counts], name: str) -> float:
        return sum(getattr(counts, name) for counts in several) / wall_s

    published = sum(counts.weights for counts in spent["learner"])
    arrived = sum(counts.weights for counts in clients)
    figures = {
        "pushes_per_s": rate(clients, "pushes"),
        "push_bytes_per_s": rate(clients, "push_bytes"),
        "transitions_per_s": rate(shards, "transitions"),
        "acks_per_s": rate(clients, "acks"),
        "resent_per_s": rate(clients, "resent"),
        "batches_per_s": rate(spent["learner"], "batches"),
        "weights_per_s": arrived / wall_s,
        "weights_published": published,
        **{f"{kind}_cores": rate(several, "cpu_s") for kind, several in spent.items()},
    }
    for name in ("ack_s", "weights_s"):
        delays = sorted(itertools.chain.from_iterable(getattr(counts, name) for counts in clients))
        for percent in (50, 99) if delays else ():
            at = min(len(delays) - 1, len(delays) * percent // 100)
            figures[f"{name.removesuffix('_s')}_p{percent}_ms"] = 1000 * delays[at]
    return {name: round(value, 4) for name, value in figures.items()}


def run(cases: list[Case], points: Path, endpoint: str) -> None:
    """Measure the cases that a file does not hold yet, and append each to it as a line of JSON."""
    held = [json.loads(line) for line in points.read_text().splitlines()] if points.exists() else []
    for case in cases:
        key = asdict(case)
        if any(all(point[name] == value for name, value in key.items()) for point in held):
            print(f"{case}: in {points} already")
            continue
        figures = measure(case, endpoint)
        with points.open("a") as file:
            file.write(json.dumps(figures) + "\n")
        print(json.dumps(figures), flush=True)
