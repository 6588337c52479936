"""Measurement of losses and of the time until inserts resume when a process of a real run is killed repeatedly.

`python tests/chaos/kills.py --role replay|actor|hub [--kills 100] [--per-run 20] [--results FILE]`

Processes, zenoh and journal are real, under the supervisor of `zsdist.launch`; only the cars are kinematic, so that
many episodes pass between two kills. Each result is a line of JSON in FILE, and a second call resumes the first.
`RESTARTS_ALLOWED` limits the kills in one run, so there are several runs.

Stored frames are read from the journal of the replay as it grows. *Inserts resume* at the first frame in it after the
kill: of the replaced actor (there is only one), by the replaced replay, or, if the hub died, after the longest pause
that began within a quarter of a second, since messages on their way still arrive. *Lost* are transitions in frames that
were acknowledged or in the journal and are not in the final counts, and the difference `produced - stored - rejected`:
all must be 0. `abandoned_at_most` counts transitions that died with their actors before they were delivered.
"""

import argparse
import contextlib
import itertools
import json
import os
import signal
import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
os.environ["PYTHONPATH"] = os.pathsep.join([*sys.path[:1], os.environ.get("PYTHONPATH", "")])

import psutil
from rehearsal import SEEN, kinematic

from zsdist import config
from zsdist.replay import records
from zsdist.roles.replay.level_journal import Entry
from zsdist.run import directory, program, ray, restarts
from zsdist.run.program import RunSpec
from zsdist.transport.base import Mailbox, Transport
from zsdist.wire import codec, keys
from zsdist.wire.messages import Ack, Push

LIGHT = (
    "transport.endpoint=tcp/127.0.0.1:7700",
    "run.actors=1",
    "run.cars_per_actor=2",
    "run.episodes=100000",
    "run.checkpoint_every_episodes=100000",
    "run.final_evaluation_episodes=0",
    "sim.max_steps=40",
    "merge.every_episodes=0",
    "low.hidden=[16]",
    "high.hidden=[16]",
    "low.updates_per_insert=0.05",
    "high.updates_per_insert=0.05",
    "scenes.train=[singleton]",
)
CALM_S = 1.0  # least time with inserts before a kill
PATIENCE_S = 60.0
POLL_S = 0.002
SOON_S = 0.25
TIMES = ("resumed_s", "pauses_s")  # until the first insert; longest time without one in the two seconds after the kill


class Log:
    """Reader of the logs of one journal, which begins a new one at each compaction."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._base, self._file, self._rest = folder, None, None, b""

    def pushes(self) -> list[Push]:
        """Return the frames since the last call."""
        bases = sorted(self._folder.glob("*.base"))  # a log counts once its base exists
        found = [] if self._file is None else self._read()  # to its end: it was complete before the next base
        if bases and bases[-1] != self._base:
            assert not self._rest, "a log ends in the middle of a record"
            self._base, self._file = bases[-1], bases[-1].with_suffix(".log").open("rb")
            found += self._read()
        return found

    def _read(self) -> list[Push]:
        self._rest += self._file.read()
        found = records.read(self._rest, self._rest[: records.MARKER_BYTES], self._base)
        self._rest = self._rest[found.end :]
        return [codec.decode(content, expect=Push) for kind, content in found.records if kind == Entry.PUSH]


class Tail:
    """Reader of all journals of a run as they are written.

    Attributes:
        arrivals: time and epoch of each frame.
        totals: frames in order and transitions produced so far, of each (stream, actor, epoch).
    """

    def __init__(self, folder: Path) -> None:
        self.arrivals: list[tuple[float, int]] = []
        self.totals: dict[tuple[str, str, int], tuple[int, int]] = {}
        self._early: dict[tuple[str, str, int], dict[int, Push]] = {}
        self._folder, self._logs = folder, {}
        self._stop, self._lock = threading.Event(), threading.Lock()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Read the rest and stop."""
        self._stop.set()
        self._thread.join()
        self.read()

    def read(self) -> int:
        """Read what is written so far; return the total number of frames."""
        with self._lock:
            self._read()
            return len(self.arrivals)

    def _follow(self) -> None:
        while not self._stop.is_set():
            self.read()
            time.sleep(POLL_S)

    def _read(self) -> None:
        for folder in sorted(self._folder.glob("journal/*/*")):
            for push in self._logs.setdefault(folder, Log(folder)).pushes():
                self._take(push, time.time())

    def _take(self, push: Push, now: float) -> None:
        self.arrivals.append((now, push.epoch))
        stream = (str(push.stream), push.actor, push.epoch)
        early = self._early.setdefault(stream, {})
        early[push.sequence] = push
        frames, produced = self.totals.get(stream, (0, 0))
        while (frame := early.pop(frames, None)) is not None:
            frames, produced = frames + 1, frame.produced
        self.totals[stream] = frames, produced


class Executioner:
    """Observer of a run that kills the process of one role whenever inserts flow and a standby process waits."""

    def __init__(self, role: str, kills: int, folder: Path) -> None:
        self.role, self.kills = role, kills
        self.tail = Tail(folder)
        self.acknowledged: dict[tuple[str, str, int], int] = {}
        self.resumed_s: list[float] = []
        self.pauses_s: list[float] = []
        self.done = False
        self._folder = folder
        self._statistics: dict[str, dict] = {}
        self._box = Mailbox(2**26)
        self._listening = False
        self._killed_s: float | None = None
        self._calm_s = time.time()
        self._victims: set[int] = set()
        self.standby_kib = 0

    def interrupted(self) -> bool:
        """Return whether all kills are done."""
        return self.done

    def watch(self, transport: Transport, now: float) -> None:
        """Read messages, and kill or measure; the runner calls it several times a second."""
        if not self._listening:
            self._listening = True
            transport.subscribe(f"zsdist/{self._folder.name}/stats/**", self._box)
            transport.subscribe(keys.ack(self._folder.name, keys.ANY), self._box)
        for message in self._box.drain():
            if "/stats/" in message.key:
                statistics = json.loads(message.payload)
                self._statistics[statistics["role"]] = statistics
            elif isinstance(ack := codec.decode(message.payload), Ack) and ack.stream in ("high", "low"):
                stream = (ack.stream, ack.actor, ack.epoch)
                self.acknowledged[stream] = max(self.acknowledged.get(stream, 0), ack.received)
        if len(self.resumed_s) == self.kills:
            self.done = True
        elif self._killed_s is None:
            self._kill(now)
        else:
            self._await(now)

    def _kill(self, now: float) -> None:
        waiting = _standby()
        victim = self._statistics.get(self.role, {}).get("pid")
        flowing = [time_s for time_s, _ in self.tail.arrivals[-1:] if now - time_s < 0.5]
        if not flowing or waiting is None or victim is None or victim in self._victims:
            self._calm_s = now
        elif now - self._calm_s > CALM_S:
            self.standby_kib = waiting
            self._victims.add(victim)
            self._killed_s, self._epoch = time.time(), max(epoch for _, epoch in self.tail.arrivals)
            os.kill(victim, signal.SIGKILL)
            with contextlib.suppress(psutil.NoSuchProcess):
                while psutil.Process(victim).status() != psutil.STATUS_ZOMBIE:
                    time.sleep(0.0005)
            self._before = self.tail.read()

    def _await(self, now: float) -> None:
        assert now - self._killed_s < PATIENCE_S, f"inserts have not resumed {PATIENCE_S} s after a {self.role} died"
        new = self._statistics[self.role]["pid"] not in self._victims
        if not new or now - self._killed_s < 2.0:
            return
        after = self.tail.arrivals[self._before :]
        if not after or now - after[-1][0] > 0.5:
            return
        times = [self._killed_s, *(time_s for time_s, _ in after)]
        pauses = [later - earlier for earlier, later in itertools.pairwise(times)]
        match self.role:
            case "replay":
                first = 1
            case "actor":
                first = 1 + next((index for index, (_, epoch) in enumerate(after) if epoch > self._epoch), len(after))
            case _:
                soon = [index for index, time_s in enumerate(times[:-1]) if time_s - self._killed_s < SOON_S]
                first = 1 + max(soon, key=pauses.__getitem__)
        if first < len(times):
            self.resumed_s.append(times[first] - self._killed_s)
            self.pauses_s.append(max(pauses))
            self._killed_s, self._calm_s = None, now
            print(
                f"{self.role} {len(self.resumed_s)}: first insert after {self.resumed_s[-1]:.3f} s, "
                f"longest pause {self.pauses_s[-1]:.3f} s",
                file=sys.stderr,
            )

    def lost(self, summary: dict) -> int:
        """Return the number of transitions that were acknowledged or journaled and are missing in the final counts."""
        lost = 0
        for level, counts in summary["transitions"].items():
            totals_of_level = {stream: totals for stream, totals in self.tail.totals.items() if stream[0] == level}
            written = sum(produced for _, produced in totals_of_level.values())
            lost += abs(written - counts["produced"]) + abs(counts["produced"] - counts["stored"] - counts["rejected"])
            lost += sum(
                max(0, received - self.tail.totals.get(stream, (0, 0))[0])
                for stream, received in self.acknowledged.items()
                if stream[0] == level
            )
        return lost


def _standby() -> int | None:
    """Return the resident KiB of the standby process; None: there is none yet."""
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if " ".join(process.cmdline()).strip() == "ray::RoleHost":
                return process.memory_info().rss // 1024
    return None


def ride(role: str, kills: int) -> dict:
    """Run once, kill processes of a role, and return the results."""
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root) / "kills"
        settings = config.load(None, LIGHT)
        directory.create(folder, settings)
        spec = RunSpec(settings, directory.key_name(folder), folder, {}, SEEN, kinematic)
        epochs = directory.issue_epochs(folder, program.epoch_count(settings))
        executioner = Executioner(role, kills, folder)
        ray.run(spec, epochs, interrupted=executioner.interrupted, watch=executioner.watch)
        executioner.tail.close()
        summary = json.loads((folder / "summary.json").read_text())
        return {
            "role": role,
            "resumed_s": [round(value, 4) for value in executioner.resumed_s],
            "pauses_s": [round(value, 4) for value in executioner.pauses_s],
            "lost": executioner.lost(summary),
            "abandoned_at_most": sum(counts["abandoned_at_most"] for counts in summary["transitions"].values()),
            "produced": sum(counts["produced"] for counts in summary["transitions"].values()),
            "restarts": summary["restarts"],
            "standby_kib": executioner.standby_kib,
        }


def main() -> None:
    """Add runs to the results until there are enough kills, and print a summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--role", choices=restarts.RESTARTED, required=True)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--per-run", type=int, default=restarts.RESTARTS_ALLOWED)
    parser.add_argument("--results", type=Path, default=Path("runs/kills.jsonl"), help="appended to")
    options = parser.parse_args()
    options.results.parent.mkdir(parents=True, exist_ok=True)
    while (left := options.kills - len(_of(options)["resumed_s"])) > 0:
        row = ride(options.role, min(left, options.per_run))
        with options.results.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{options.role}: {options.kills - left + len(row['resumed_s'])} kills of {options.kills}", flush=True)
    found = _of(options)
    print(f"{options.role}: {options.kills} kills, {found['produced']} transitions produced, {found['lost']} lost")
    for name in TIMES:
        times = found[name]
        p99 = times[min(len(times) - 1, int(0.99 * len(times)))]
        print(f"{name:12}median {statistics.median(times):.3f}  p99 {p99:.3f}  most {times[-1]:.3f}")
    print(json.dumps(found))
    sys.exit(bool(found["lost"]))


def _of(options: argparse.Namespace) -> dict:
    """Return all results of the role together."""
    lines = options.results.read_text().splitlines() if options.results.exists() else []
    rows = [row for line in lines if (row := json.loads(line))["role"] == options.role]
    return {
        "role": options.role,
        **{name: sorted(value for row in rows for value in row[name]) for name in TIMES},
        **{name: sum(row[name] for row in rows) for name in ("lost", "produced", "abandoned_at_most")},
        "standby_kib": max((row["standby_kib"] for row in rows), default=0),
    }


if __name__ == "__main__":
    main()
