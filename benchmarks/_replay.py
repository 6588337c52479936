"""Replay service in processes of its own, with synthetic actors and learners as its clients.

Hub, replay role, outbox, codec and transport are the package's own. Only the content of the trajectories is synthetic.
"""

import multiprocessing
import tempfile
import threading
import time
from collections import deque
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Self

import numpy as np
from _common import require
from wire import make_trajectory

from zsdist.config import Config
from zsdist.dqn.batches import from_stored
from zsdist.protocol.outbox import Outbox
from zsdist.roles.base import Context
from zsdist.roles.learner import ASK_AGAIN_AFTER_S, BATCHES_AN_ANSWER, PREFETCH
from zsdist.roles.replay.level_replay import Shape
from zsdist.roles.replay.role import Replay
from zsdist.run.allocator import keep_freed_memory
from zsdist.transport.base import Mailbox, Transport
from zsdist.transport.zenoh import ZenohHub, ZenohTransport
from zsdist.types import Batch, Level, Trajectory
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders, Push, SampleReply, SampleRequest

psutil = require("psutil", "pip install psutil")
keep_freed_memory()  # as in every role's process; the processes of hub and replay run this line too

RUN = "benchmark"
ACTIONS = 5
ENDPOINT = "tcp/127.0.0.1:7600"  # or the next free port above it
TRAJECTORIES = 64  # number of distinct trajectories, which all actors push in turn
ANSWER_WITHIN_S = 10.0
_spawn = multiprocessing.get_context("spawn")


class ReplayService:
    """Hub and replay in a process each, as in a run."""

    def __init__(self, config: Config, state_size: int) -> None:
        self._processes: dict[str, multiprocessing.process.BaseProcess] = {}
        self._config = config
        self.endpoint = self._start("hub", _serve_hub)
        self._start("replay", _serve_replay, self.endpoint, config, state_size)
        self._scheduler = ZenohTransport(self.endpoint)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._scheduler.close()
        for process in reversed(self._processes.values()):
            process.terminate()
            process.join()

    def admit(self, epochs: dict[str, int]) -> None:
        """Send the replay the epoch of each actor to accept, as the scheduler does."""
        settings = self._config.replay
        orders = {"epochs": epochs, "buffer_size": settings.size_initial, "batch_size": settings.batch_initial}
        payload = codec.encode(Orders(1, "replay", orders | {"stop": False}))
        self._scheduler.publish(keys.control(RUN, "replay"), payload, retained=True)

    def cpu_s(self) -> dict[str, float]:
        """Return the CPU seconds that hub and replay have used so far."""
        times = {name: psutil.Process(process.pid).cpu_times() for name, process in self._processes.items()}
        return {name: spent.user + spent.system for name, spent in times.items()}

    def resident_bytes(self) -> int:
        """Return the resident memory of the replay's process in bytes."""
        return psutil.Process(self._processes["replay"].pid).memory_info().rss

    def _start(self, name: str, serve: object, *arguments: object) -> str:
        ours, theirs = _spawn.Pipe()
        self._processes[name] = _spawn.Process(target=serve, args=(theirs, *arguments), name=name, daemon=True)
        self._processes[name].start()
        return ours.recv()


def _serve_hub(ready: Connection) -> None:
    with ZenohHub(ENDPOINT) as hub:
        ready.send(hub.endpoint)
        threading.Event().wait()


def _serve_replay(ready: Connection, endpoint: str, config: Config, state_size: int) -> None:
    transport, wake = ZenohTransport(endpoint), threading.Event()
    context = Context(config, RUN, "replay", "0", 1, transport, wake)
    with tempfile.TemporaryDirectory() as folder:
        replay = Replay(context, dict.fromkeys(Level, Shape(state_size, ACTIONS)), Path(folder, "journal"))
        ready.send("")
        while (due_s := replay.step(time.time())) is not None:
            wake.wait(max(0.0, due_s - time.time()))
            wake.clear()


class Actors:
    """Synthetic actors that share one transport; each has an outbox and always `ahead` more transitions to offer."""

    def __init__(self, transport: Transport, config: Config, level: Level, epochs: dict[str, int], size: int) -> None:
        settings = config.transport
        self._transport = transport
        self._trajectories = [replace(trajectory, level=level) for trajectory in make_trajectories(size)]
        self._next = 0
        self.wake = threading.Event()
        self.level = level
        self.outboxes = {
            name: Outbox(
                level,
                name,
                epoch,
                window_frames=settings.window_frames,
                resend_after_s=settings.resend_after_s,
                give_up_after_s=settings.give_up_after_s,
                make_frame=Push,
            )
            for name, epoch in epochs.items()
        }
        self._acks = Mailbox(settings.mailbox_bytes, self.wake.set)
        for name in epochs:
            transport.subscribe(keys.ack(RUN, name), self._acks)

    @property
    def produced(self) -> int:
        """Number of transitions in numbered frames."""
        return sum(outbox.produced for outbox in self.outboxes.values())

    @property
    def unacknowledged(self) -> int:
        """Number of frames that the replay has not acknowledged."""
        return sum(outbox.statistics()["unacknowledged_frames"] for outbox in self.outboxes.values())

    @property
    def resent(self) -> int:
        """Number of repeated sendings of frames."""
        return sum(outbox.statistics()["resent_frames"] for outbox in self.outboxes.values())

    @property
    def heard(self) -> bool:
        """True if the replay has granted credit to every actor."""
        return all(outbox.credit is None or outbox.credit > 0 for outbox in self.outboxes.values())

    def step(self, ahead: int) -> bool:
        """Read acknowledgements, offer and push; return whether there was anything to push."""
        now, busy = time.time(), False
        self.wake.clear()
        for message in self._acks.drain():
            ack = codec.decode(message.payload)
            if ack.stream == self.level:
                self.outboxes[ack.actor].on_ack(ack, now)
        for name, outbox in self.outboxes.items():
            while outbox.waiting < ahead:
                trajectory = self._trajectories[self._next % TRAJECTORIES]
                if not outbox.reserve(len(trajectory)):
                    break
                outbox.offer([trajectory])
                self._next += 1
            for frame in outbox.poll(now):
                busy = True
                self._transport.publish(keys.push(RUN, self.level, name, frame.epoch), codec.encode(frame))
        return busy

    def run(self, seconds: float, ahead: int) -> None:
        """Push trajectories for `seconds`, with `ahead` transitions waiting per actor."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            if not self.step(ahead):
                self.wake.wait(0.01)

    def settle(self) -> None:
        """Wait until the replay has acknowledged everything that was pushed."""
        while self.unacknowledged or any(outbox.waiting for outbox in self.outboxes.values()):
            if not self.step(0):
                self.wake.wait(0.01)


class Sampler:
    """Learner that receives batches and does not train on them."""

    def __init__(self, transport: Transport, mailbox_bytes: int, level: Level) -> None:
        self.batches = 0
        self.transitions = 0
        self.lost = 0  # number of batches in replies that did not arrive
        self._transport, self._level = transport, level
        self._asked: deque[tuple[float, int]] = deque()  # time and number of batches of each request
        self.wake = threading.Event()
        self._box = Mailbox(mailbox_bytes, self.wake.set)

    def step(self, in_flight: int = PREFETCH, at_once: int = BATCHES_AN_ANSWER) -> Batch | None:
        """Decode the batches that have arrived and request more, as a learner does; return the last batch."""
        batch, now = None, time.monotonic()
        self.wake.clear()
        for message in self._box.drain():
            reply = codec.decode(message.payload)
            if self._asked:
                self._asked.popleft()
            if isinstance(reply, SampleReply) and reply.batch is not None:
                batch = from_stored(reply.batch).parts(reply.batches)[-1]
                self.batches += reply.batches
                self.transitions += len(reply.batch)
        while self._asked and now - self._asked[0][0] > ASK_AGAIN_AFTER_S:
            self.lost += self._asked.popleft()[1]
        while sum(batches for _, batches in self._asked) + at_once <= in_flight:
            request = codec.encode(SampleRequest(1, self._level, self.batches, at_once))
            key = keys.sample(RUN, self._level)
            self._transport.request(key, request, self._box, timeout_s=ANSWER_WITHIN_S)
            self._asked.append((now, at_once))
        return batch

    def run(self, seconds: float, at_once: int = BATCHES_AN_ANSWER) -> None:
        """Receive batches for `seconds`, `at_once` of them in a message."""
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            if self.step(at_once=at_once) is None:
                self.wake.wait(0.1)
        while self._asked:
            self.step(in_flight=0)
            self.wake.wait(0.1)

    def one(self) -> Batch:
        """Request one batch and wait for it; no other request may be pending."""
        batch = None
        while batch is None:
            if not self._asked:
                self.step(in_flight=1, at_once=1)
            self.wake.wait(0.1)
            batch = self.step(in_flight=0)
        return batch


def make_trajectories(state_size: int) -> list[Trajectory]:
    """Return the trajectories to push, the same in every call."""
    rng = np.random.default_rng(0)
    return [make_trajectory(rng, state_size) for _ in range(TRAJECTORIES)]


def pairs(state_size: int) -> dict[str, np.ndarray]:
    """Return the transitions that all actors push, as columns, for peers without trajectories."""
    trajectories = make_trajectories(state_size)
    return {
        "state": np.concatenate([trajectory.states[:-1] for trajectory in trajectories]),
        "action": np.concatenate([trajectory.actions for trajectory in trajectories]),
        "reward": np.concatenate([trajectory.rewards for trajectory in trajectories]),
        "discount": np.concatenate([trajectory.discounts for trajectory in trajectories]),
        "next_state": np.concatenate([trajectory.states[1:] for trajectory in trajectories]),
    }
