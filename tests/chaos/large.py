"""Large runs: networks of [2048,2048], and a ring of a million rows; each is killed as a whole and resumed.

`python tests/chaos/large.py [--cases networks ring] [--rows 1000000]`

Cars are kinematic. The ring is filled by actors without cars. The times are the last line of the output.
"""

import argparse
import itertools
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import psutil
from small_run import SYNTHETIC, Launcher, Witness, end_cleanly, wait_for

from zsdist.run import checkpoint_files

WIDE = (
    "low.hidden=[2048,2048]",
    "high.hidden=[2048,2048]",
    "replay.batch_initial=32",
    "merge.every_episodes=6",
    "merge.validation_scenes=2",
    "merge.distil_updates=2",
    "low.updates_per_insert=0.01",
    "high.updates_per_insert=0.01",
    "run.checkpoint_every_s=10",
)
PATIENCE_S = 600.0


class Large:
    """Large run, and the times of what it did.

    Args:
        root: folder of the run.
        settings: its settings.
    """

    def __init__(self, root: Path, *settings: str) -> None:
        self.root, self.settings = root, settings
        self.times: dict[str, float] = {}
        self.most_mib: dict[str, float] = {}
        self._next_s = 0.0
        self.launcher = Launcher(root, *settings)
        self.witness = Witness(self.launcher)

    def poll(self) -> None:
        """Take in what has happened, and the memory of each role twice a second."""
        self.witness.poll()
        self.launcher.require_running()
        if time.time() < self._next_s:
            return
        self._next_s = time.time() + 0.5
        for name, about in self.witness.statistics.items():
            if psutil.pid_exists(about["pid"]):
                mib = psutil.Process(about["pid"]).memory_info().rss / 2**20
                self.most_mib[name] = round(max(mib, self.most_mib.get(name, 0.0)))

    def until(self, name: str, condition) -> None:
        """Wait for a condition, and note the seconds under a name."""
        began_s = time.time()
        wait_for(condition, PATIENCE_S, name, self.poll)
        self.times[name] = round(time.time() - began_s, 2)
        print(f"{name}: {self.times[name]} s", file=sys.stderr, flush=True)

    def update(self, name: str) -> None:
        """Wait for an update of a learner beyond those that it reports at first."""
        first: dict[str, int] = {}

        def learned() -> bool:
            updates = {
                name: self.witness.statistics[name]["learner_updates"] for name in self.witness.name_of("learner")
            }
            return any(count > first.setdefault(name, count) for name, count in updates.items())

        self.until(name, learned)

    def sum_of(self, role: str, field: str) -> float:
        """Return the sum of a statistic over the roles of a kind."""
        return sum(self.witness.statistics[name].get(field, 0) for name in self.witness.name_of(role))

    def checkpoint(self, name: str) -> None:
        """Wait for a checkpoint that begins from now on."""
        newest = self._newest()
        self.until(name, lambda: self._newest() != newest)

    def _newest(self) -> tuple[str, float] | None:
        folders = checkpoint_files.checkpoints(self.launcher.folder)
        return (folders[-1].name, folders[-1].stat().st_mtime) if folders else None

    def kill_and_resume(self) -> None:
        """Kill everything, and resume."""
        self.launcher.kill(alone=False)
        self.launcher = Launcher(self.root)
        self.witness.attach(self.launcher)

    def finish(self) -> dict:
        """Interrupt the run, and return all times; the launcher checks its books."""
        began_s = time.time()
        self.launcher.note_family()
        self.launcher.process.send_signal(signal.SIGINT)
        wait_for(lambda: self.launcher.process.poll() is not None, PATIENCE_S, "the end", self.witness.poll)
        status = self.launcher.process.returncode
        assert status == 128 + signal.SIGINT, f"exit status {status}: {self.launcher.last_words()}"
        self.times["save and end"] = round(time.time() - began_s, 2)
        summary = json.loads((self.launcher.folder / "summary.json").read_text())
        return {"s": self.times, "most_mib": self.most_mib, "transitions": summary["transitions"]}


def networks(large: Large) -> dict:
    """Run, merge, checkpoint, kill, resume and merge again with wide networks."""
    large.until("first update", lambda: large.sum_of("learner", "learner_updates") > 0)
    large.until("first merge", lambda: large.sum_of("scheduler", "merges") > 0)
    large.checkpoint("next checkpoint")
    merges = large.sum_of("scheduler", "merges")
    large.kill_and_resume()
    large.update("resumed to the first update")
    large.until("next merge", lambda: large.sum_of("scheduler", "merges") > merges)
    return large.finish()


def ring(large: Large, rows: int) -> dict:
    """Fill the rings, write checkpoints, kill a replay and then everything, and resume."""

    def held() -> float:
        return min(large.sum_of("replay", f"{level}_size") for level in ("low", "high"))

    large.until("rings full", lambda: held() >= rows)
    large.checkpoint("checkpoint of full rings")
    name = large.witness.name_of("replay")[0]
    epoch = large.witness.statistics[name]["epoch"]
    psutil.Process(large.witness.statistics[name]["pid"]).kill()
    large.until("replay replaced", lambda: large.witness.statistics[name]["epoch"] > epoch and held() >= rows)
    large.kill_and_resume()
    large.until("resumed with full rings", lambda: held() >= rows)
    large.update("next update")
    return large.finish()


def main() -> None:
    """Run the cases, and print their times."""
    end_cleanly()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=("networks", "ring"), default=("networks", "ring"))
    parser.add_argument("--rows", type=int, default=1_000_000)
    options = parser.parse_args()
    found = {}
    for case in options.cases:
        with tempfile.TemporaryDirectory(prefix=f"{case}-") as root:
            if case == "ring":
                os.environ[SYNTHETIC] = "1"
            settings = WIDE if case == "networks" else _of_ring(options.rows)
            large = Large(Path(root), *settings)
            try:
                found[case] = networks(large) if case == "networks" else ring(large, options.rows)
            finally:
                large.witness.close()
                large.launcher.kill(alone=False)
    print(json.dumps(found))


def _of_ring(rows: int) -> tuple[str, ...]:
    sizes = ("size_initial", "size_max")
    return (
        *(f"replay.{name}={rows}" for name in sizes),
        f"replay.max_bytes={2**31}",
        "replay.shards=2",
        "run.actors=2",
        "replay.prioritised=false",
        "run.checkpoint_every_s=10",
        *itertools.chain.from_iterable(
            (f"{level}.min_size={rows}", f"{level}.updates_per_insert=0.01") for level in ("low", "high")
        ),
    )


if __name__ == "__main__":
    main()
