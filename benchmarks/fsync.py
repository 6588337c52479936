"""Cost of `replay.fsync_ms`: what it takes to have acknowledged transitions on the disk.

`python benchmarks/fsync.py [--quick] [--folder DIR]` prints a table, then one JSON line. A replay with a journal there
(by default in the current folder, which must lie on the disk in question) takes frames of one actor over a transport in
memory, once for each setting in turn, several rounds. *Latency*: from the push of one frame until its acknowledgement,
which waits up to 20 ms for more frames in any case. *Rate*: with 64 frames on their way all the time.
"""

import argparse
import os
import statistics
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from _common import report
from _replay import ACTIONS, make_trajectories

from zsdist.config import parse
from zsdist.roles.base import Context
from zsdist.roles.replay.role import Replay
from zsdist.roles.shapes import Shape
from zsdist.transport.base import Mailbox
from zsdist.transport.memory import MemoryBroker, MemoryTransport
from zsdist.types import Level
from zsdist.wire import codec, keys
from zsdist.wire.messages import Orders, Push

RUN, ACTOR, STATE_SIZE, WINDOW = "fsync", "actor-0", 256, 64
SETTINGS = {"never": None, "always": 0, "20_ms": 20, "100_ms": 100}


class Bench:
    """One replay, and one actor that counts what is acknowledged."""

    def __init__(self, folder: Path, fsync_ms: int | None) -> None:
        broker = MemoryBroker()
        config = parse({"replay": {"fsync_ms": fsync_ms}, "low": {"min_size": 10**9}})
        self._actor, self._acks = MemoryTransport(broker), Mailbox(2**24)
        self._actor.subscribe(keys.ack(RUN, ACTOR), self._acks)
        context = Context(config, RUN, "replay", "0", 1, MemoryTransport(broker), threading.Event())
        self._replay = Replay(context, {Level.LOW: Shape(STATE_SIZE, ACTIONS)}, folder)
        orders = {"epochs": {ACTOR: 1}, "buffer_size": 10_000, "batch_size": 16, "stop": False}
        self._actor.publish(keys.control(RUN, "replay"), codec.encode(Orders(1, "replay", orders)))
        self._trajectory = replace(max(make_trajectories(STATE_SIZE), key=len), level=Level.LOW)
        self._sent = self._acknowledged = 0
        self._replay.step(time.time())

    def _push(self) -> None:
        length = len(self._trajectory)
        frame = Push(Level.LOW, ACTOR, 1, self._sent, (self._sent + 1) * length, False, (self._trajectory,))
        self._sent += 1
        self._actor.publish(keys.push(RUN, Level.LOW, ACTOR, 1), codec.encode(frame))

    def _step(self) -> None:
        wake_s = self._replay.step(time.time())
        acks = [codec.decode(message.payload).received for message in self._acks.drain()]
        self._acknowledged = max([self._acknowledged, *acks])
        if not acks and wake_s is not None:
            time.sleep(min(max(0.0, wake_s - time.time()), 0.25))

    def latency_ms(self, frames: int) -> float:
        """Median time until one frame is acknowledged."""
        times = []
        for _ in range(frames):
            begun_s = time.perf_counter()
            self._push()
            while self._acknowledged < self._sent:
                self._step()
            times.append(1000 * (time.perf_counter() - begun_s))
        return statistics.median(times)

    def rate(self, seconds: float) -> float:
        """Transitions per second that are acknowledged."""
        begun_s, before = time.perf_counter(), self._acknowledged
        while time.perf_counter() - begun_s < seconds:
            while self._sent - self._acknowledged < WINDOW:
                self._push()
            self._step()
        return (self._acknowledged - before) * len(self._trajectory) / (time.perf_counter() - begun_s)


def main() -> None:
    """Measure all settings in turn, and print medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer rounds; ends within 50 s")
    parser.add_argument("--folder", type=Path, default=Path(), help="folder on the disk to measure")
    options = parser.parse_args()
    rounds, frames, seconds = (3, 20, 1.0) if options.quick else (7, 40, 2.0)
    found: dict[str, list[float]] = {}
    for _ in range(rounds):
        for name, fsync_ms in SETTINGS.items():
            with tempfile.TemporaryDirectory(dir=options.folder) as folder:
                bench = Bench(Path(folder, "journal"), fsync_ms)
                found.setdefault(f"{name}_latency_ms", []).append(bench.latency_ms(frames))
                found.setdefault(f"{name}_transitions_per_s", []).append(bench.rate(seconds))
    figures = {name: statistics.median(values) for name, values in found.items()}
    rate = figures["never_transitions_per_s"]
    ratios = {f"{name}_vs_never": figures[f"{name}_transitions_per_s"] / rate for name in SETTINGS if name != "never"}
    report("fsync", figures, ratios)


if __name__ == "__main__":
    main()
