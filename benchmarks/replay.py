"""Replay service against others: inserts and samples a second, and latency of a batch of 256.

`python benchmarks/replay.py [--quick] [--peers DIR]` prints a table, then one JSON line. Ours is what a run starts: hub
and replay are processes of their own; one client pushes trajectories through the real outbox with acknowledgements and
receives batches, with as many in flight as a run's learner has (16). Each peer has a client of its own and gets the
same transitions (256 features, so 2,048 bytes of float32 states each) into a ring of the same size:

- a Ray actor with a numpy ring, 64 transitions a call, 16 calls in flight, and 16 batches in flight when sampling;
- Reverb, where DIR/reverb has it: its trajectory writer, which sends each state once, and its TrajectoryDataset;
- TorchRL, where DIR/torchrl has it: a storage in the client's own process, without a service.

`make peers` creates DIR; a missing peer is left out. An insert counts once the other side has acknowledged it, so each
round ends with everything stored. Ours also rounds states to half floats, checks every value, and stores masks and
guide actions, which the peers do not get. One system is loaded at a time, in turn, and a figure is the median of the
rounds. `sample` is one batch a message on both sides, `sample_4` four batches a message, as a run's learner requests
them; a Ray actor can do that too. `batch_ms` is the time of batches requested one at a time. Reverb's dataset fetches
ahead, so its time is a lower bound, and its samples a second are compared with our `sample_4`.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from _common import report
from _replay import Actors, ReplayService, Sampler, pairs

from zsdist.config import parse
from zsdist.roles.learner import BATCHES_AN_ANSWER
from zsdist.transport.zenoh import ZenohTransport
from zsdist.types import Level

STATE_SIZE = 256
BATCH = 256
CAPACITY = 10_000  # as the peers'
AHEAD = 256  # number of transitions that the client has waiting: enough to fill a frame
HERE = Path(__file__).parent
PEERS = {  # script, environment below the folder of peers (None: this one)
    "ray_actor": ("ray_actor.py", None),
    "reverb": ("reverb_server.py", "reverb"),
    "torchrl_in_process": ("torchrl_storage.py", "torchrl"),
}


PLURALS = {"insert": "inserts", "sample": "samples", "sample_4": "samples_4"}
RATES = tuple(PLURALS)
FOUR = ("ours", "ray_actor")  # systems that can send several batches in a message


class Ours:
    """Client of our replay. One level accepts inserts without limit; the other is filled once and then sampled."""

    def __init__(self, endpoint: str, service: ReplayService, config: object) -> None:
        self._transports = [ZenohTransport(endpoint) for _ in range(2)]
        epochs = {"client": 1}
        self._writer = Actors(self._transports[0], config, Level.HIGH, epochs, STATE_SIZE)
        filler = Actors(self._transports[0], config, Level.LOW, epochs, STATE_SIZE)
        self._reader = Sampler(self._transports[1], config.transport.mailbox_bytes, Level.LOW)
        service.admit(epochs)
        while filler.produced < CAPACITY:
            filler.run(0.05, AHEAD)
        filler.settle()

    def insert(self, seconds: float) -> float:
        """Return inserted transitions a second, including the wait for the last acknowledgement."""
        before, began_s = self._writer.produced, time.perf_counter()
        self._writer.run(seconds, AHEAD)
        self._writer.settle()
        return (self._writer.produced - before) / (time.perf_counter() - began_s)

    def sample(self, seconds: float, at_once: int = 1) -> float:
        """Return sampled transitions a second, with `at_once` batches in a message."""
        before, began_s = self._reader.transitions, time.perf_counter()
        self._reader.run(seconds, at_once)
        return (self._reader.transitions - before) / (time.perf_counter() - began_s)

    def sample_4(self, seconds: float) -> float:
        """Return sampled transitions a second, with as many batches in a message as a run's learner requests."""
        return self.sample(seconds, at_once=BATCHES_AN_ANSWER)

    def latency(self, count: int) -> list[float]:
        """Return the milliseconds of batches requested one at a time."""
        times_ms = []
        for _ in range(count):
            began_s = time.perf_counter()
            self._reader.one()
            times_ms.append(1000 * (time.perf_counter() - began_s))
        return times_ms

    @property
    def resent(self) -> int:
        """Number of frames that were sent again."""
        return self._writer.resent

    @property
    def lost(self) -> int:
        """Number of batches that were requested and did not arrive."""
        return self._reader.lost

    def close(self) -> None:
        """Disconnect from the hub."""
        for transport in self._transports:
            transport.close()


class PeerProcess:
    """Client of a peer, in a process of the peer's own environment."""

    def __init__(self, python: Path, script: str, data: Path, errors: Path) -> None:
        self._process = subprocess.Popen(
            [python, HERE / "peers" / script, data],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors.open("w"),
            text=True,
        )
        self._errors = errors

    def wait_until_ready(self) -> None:
        """Wait until the peer accepts commands."""
        self._answer()

    def insert(self, seconds: float) -> float:
        """See `Ours.insert`."""
        return self._ask(f"insert {seconds}")

    def sample(self, seconds: float) -> float:
        """See `Ours.sample`."""
        return self._ask(f"sample {seconds}")

    def sample_4(self, seconds: float) -> float:
        """See `Ours.sample_4`."""
        return self._ask(f"sample_4 {seconds}")

    def latency(self, count: int) -> list[float]:
        """See `Ours.latency`."""
        return self._ask(f"latency {count}")

    def close(self) -> None:
        """Let the process end, or kill it: the threads of a Reverb dataset sometimes keep their process alive."""
        self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _ask(self, order: str) -> object:
        print(order, file=self._process.stdin, flush=True)
        return self._answer()

    def _answer(self) -> object:
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"{self._process.args[1]} ended: {self._errors.read_text()[-2000:].strip()}")
        return json.loads(line)


def main() -> None:
    """Start the systems, load them in turn, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer and shorter rounds; ends within 50 s on two cores")
    parser.add_argument("--peers", type=Path, default=HERE.parent / ".peers", help="folder of the peers' environments")
    options = parser.parse_args()
    rounds, seconds, batches = (3, 0.5, 100) if options.quick else (7, 1.0, 400)
    torch.set_num_threads(1)
    low = {"min_size": CAPACITY, "updates_per_insert": 10_000.0}
    ring = {"batch_initial": BATCH, "size_initial": CAPACITY}
    config = parse({"high": {"min_size": 10**9}, "low": low, "replay": ring})
    with tempfile.TemporaryDirectory() as folder, ReplayService(config, STATE_SIZE) as service:
        data = Path(folder) / "transitions.npz"
        np.savez(data, **pairs(STATE_SIZE))
        systems: dict[str, Ours | PeerProcess] = {}
        for name, (script, environment) in PEERS.items():
            python = Path(sys.executable) if environment is None else options.peers / environment / "bin" / "python"
            if python.exists():
                systems[name] = PeerProcess(python, script, data, Path(folder) / f"{name}.log")
        ours = Ours(service.endpoint, service, config)
        for peer in systems.values():
            peer.wait_until_ready()
        systems = {"ours": ours, **systems}
        try:
            rates = measure(systems, rounds, seconds, batches)
        finally:
            for system in systems.values():
                system.close()
        summarise(rates, {"ours_resent_frames": float(ours.resent), "ours_lost_batches": float(ours.lost)})


def measure(systems: dict, rounds: int, seconds: float, batches: int) -> dict[str, dict[str, list[float]]]:
    """Return each system's rates, one value a round, and all latencies; the first round warms up and is dropped."""
    found: dict[str, dict[str, list[float]]] = {
        name: {figure: [] for figure in (*RATES, "batch_ms")} for name in systems
    }
    for number in range(rounds + 1):
        for figure in RATES:
            for name, system in systems.items():
                if figure == "sample_4" and name not in FOUR:
                    continue
                value = getattr(system, figure)(seconds)
                if number:
                    found[name][figure].append(value)
        for name, system in systems.items():
            times_ms = system.latency(batches)
            if number:
                found[name]["batch_ms"] += times_ms
        print(f"round {number} of {rounds}{'' if number else ', to warm up'}", file=sys.stderr, flush=True)
    return found


def summarise(found: dict[str, dict[str, list[float]]], figures: dict[str, float]) -> None:
    """Print the table and the JSON line."""
    ratios: dict[str, float] = {}
    medians = {
        name: {figure: statistics.median(values[figure]) for figure in RATES if values[figure]}
        for name, values in found.items()
    }
    print(f"{'system':22}{'insert/s':>10}{'sample/s':>10}{'sample_4/s':>12}{'batch p50 ms':>14}{'p99 ms':>9}")
    for name, values in found.items():
        p50, p99 = np.percentile(values["batch_ms"], (50, 99))
        rates = medians[name]
        four = f"{rates['sample_4']:12.0f}" if "sample_4" in rates else f"{'-':>12}"
        print(f"{name:22}{rates['insert']:10.0f}{rates['sample']:10.0f}{four}{p50:14.2f}{p99:9.2f}")
        figures |= {f"{name}_{PLURALS[figure]}_per_s": rate for figure, rate in rates.items()}
        figures |= {f"{name}_batch_p50_ms": p50, f"{name}_batch_p99_ms": p99}
        if name != "ours":
            ratios[f"insert_vs_{name}"] = medians["ours"]["insert"] / rates["insert"]
            if name == "reverb":
                ratios["sample_vs_reverb_dataset"] = medians["ours"]["sample_4"] / rates["sample"]
            else:
                ratios[f"sample_vs_{name}"] = medians["ours"]["sample"] / rates["sample"]
            if "sample_4" in rates:
                ratios[f"sample_4_vs_{name}"] = medians["ours"]["sample_4"] / rates["sample_4"]
                ratios[f"sample_4_vs_{name}_sample"] = medians["ours"]["sample_4"] / rates["sample"]
    report("replay", figures, ratios)


if __name__ == "__main__":
    main()
