"""Soak: a run of real processes for an hour, in which something is killed or stopped every 20 seconds.

`python tests/chaos/soak.py [--hours 1] [--results FILE]`, or `make soak HOURS=1`

Victims are random: most often one role, by SIGKILL or SIGSTOP, sometimes two, and now and then the whole run, which is
resumed. The rings are small, so that they are full within minutes. The resident memory of every role is sampled each
second. At the end the counts of `tests/chaos/oracle.py` must show no fault, the memory of each role must not have
grown, and no process and no port may be left after 10 seconds.

*Growth* of a role compares the second and the last quarter of the time after the rings were full: medians of all
samples of processes that have lived for 5 seconds. The goal is 5% or 8 MiB.
"""

import argparse
import json
import signal
import socket
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import oracle
import psutil
from kills import MANY, ROLES, START_WITHIN_S, Killing
from small_run import end_cleanly

EVERY_S = 20.0
SAMPLE_S = 1.0
GROWN_UP_S = 5.0
RING = 3000
SETTINGS = (f"replay.size_initial={RING}", f"replay.size_max={RING}", "replay.size_min=1000", "run.actors=2")
LAUNCHER_SHARE, STOP_SHARE, TWICE_SHARE = 0.05, 0.25, 0.2
ALLOWED_SHARE, ALLOWED_MIB = 0.05, 8.0
LEFT_WITHIN_S = 10.0


class Memory:
    """Samples of the resident memory of each role.

    Args:
        killing: run that is sampled.
    """

    def __init__(self, killing: Killing) -> None:
        self.samples: dict[str, list[tuple[float, float]]] = defaultdict(list)  # time, MiB
        self._killing, self._next_s = killing, 0.0

    def sample(self) -> None:
        """Take a sample where one is due."""
        now = time.time()
        if now < self._next_s:
            return
        self._next_s = now + SAMPLE_S
        launcher = self._killing.launcher
        pids = {name: about["pid"] for name, about in self._killing.witness.statistics.items()}
        for process in launcher.note_family():
            try:
                name = "launcher" if process.pid == launcher.process.pid else process.name()
                name = next((role for role, pid in pids.items() if pid == process.pid), name)
                if now - process.create_time() > GROWN_UP_S and not name.startswith("ray::"):
                    self.samples[name].append((now, process.memory_info().rss / 2**20))
            except psutil.Error:
                continue

    def growth(self, full_s: float) -> dict[str, dict]:
        """Return the growth of each role since the rings were full."""
        end_s, found = time.time(), {}
        quarter_s = (end_s - full_s) / 4
        for name, samples in self.samples.items():
            second = [mib for at_s, mib in samples if full_s + quarter_s <= at_s < full_s + 2 * quarter_s]
            last = [mib for at_s, mib in samples if at_s >= end_s - quarter_s]
            if len(second) >= 10 and len(last) >= 10:
                before, after = statistics.median(second), statistics.median(last)
                found[name] = {"mib": round(before, 1), "growth_mib": round(after - before, 1)}
        return found


def soak(hours: float, seed: int) -> dict:
    """Run for so many hours, and return all figures."""
    with tempfile.TemporaryDirectory(prefix="soak-") as root:
        killing = Killing(Path(root), seed, *SETTINGS, restarts_allowed=MANY)
        memory, full_s, killed = Memory(killing), None, defaultdict(int)
        try:
            end_s = time.time() + 3600 * hours
            while time.time() < end_s:
                until_s = time.time() + killing.random.uniform(0.5, 1.5) * EVERY_S

                def due(until_s: float = until_s) -> bool:
                    memory.sample()
                    return time.time() > until_s

                killing.wait_for(due, "the next kill", 10 * EVERY_S)
                if full_s is None and all(len(rows) > RING for rows in killing.tail.rows.values()):
                    full_s = time.time()
                for victim in _victims(killing):
                    killed[victim] += 1
                killed_s = time.time()

                def flows(since_s: float = killed_s) -> bool:
                    return killing.tail.last_s > since_s

                killing.wait_for(flows, "a frame after a kill", START_WITHIN_S)
            assert full_s is not None, "the rings were never full"
            growth = memory.growth(full_s)
            endpoint = (killing.launcher.folder / "endpoint").read_text()
            found = killing.finish()
            return found | {"killed": killed, "growth": growth, "left": _left(killing, endpoint), "hours": hours}
        finally:
            killing.abandon()


def _victims(killing: Killing) -> list[str]:
    """Kill or stop something, and return what."""
    if killing.random.random() < LAUNCHER_SHARE:
        killing.kill_launcher()
        return ["launcher"]
    number = signal.SIGSTOP if killing.random.random() < STOP_SHARE else signal.SIGKILL
    roles = killing.random.sample(ROLES, 2 if killing.random.random() < TWICE_SHARE else 1)
    found = [f"{role} {number.name}" for role in roles if killing.strike(role, number)]
    print(time.strftime("%H:%M:%S"), *found, file=sys.stderr, flush=True)
    return found


def _left(killing: Killing, endpoint: str) -> list[str]:
    """Return the processes and the port that are left some time after the end."""
    end_s = time.time() + LEFT_WITHIN_S
    while (left := killing.launcher.left()) and time.time() < end_s:
        time.sleep(0.1)
    with socket.socket() as probe:
        taken = probe.connect_ex(("127.0.0.1", int(endpoint.rpartition(":")[2]))) == 0
    return [*(str(process) for process in left), *([endpoint] if taken else [])]


def main() -> None:
    """Soak, add the figures to a file, and print them."""
    end_cleanly()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--results", type=Path, default=Path("runs/soak.jsonl"), help="appended to")
    options = parser.parse_args()
    options.results.parent.mkdir(parents=True, exist_ok=True)
    found = soak(options.hours, options.seed)
    with options.results.open("a") as file:
        file.write(json.dumps(found) + "\n")
    grown = [
        name for name, of in found["growth"].items() if of["growth_mib"] > max(ALLOWED_MIB, ALLOWED_SHARE * of["mib"])
    ]
    print(json.dumps({name: value for name, value in found.items() if name != "pauses_s"}))
    sys.exit(bool(grown or found["left"] or any(found[name] for name in oracle.FAULTS)))


if __name__ == "__main__":
    main()
