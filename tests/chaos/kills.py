"""Measurement of losses, and of the time until a run works again, when its processes are killed or stopped.

`python tests/chaos/kills.py --role ROLE [--stop] [--kills 100] [--per-run 20] [--results FILE]`

ROLE is replay, actor, hub, scheduler, learner, launcher (everything of the run dies, and it is resumed), or all: random
ones of the first five, several at once, before the last is replaced. Processes, zenoh, journals and supervisor are
real; only the cars are kinematic. Each run adds a line of JSON to FILE, and a second call goes on where the first was.
The figures are the last line of the output.

| role | works again with |
|---|---|
| replay | the first frame in a journal |
| actor | the first frame of the new incarnation in a journal; there is one actor |
| hub | the first frame after the longest pause that began within a quarter of a second; the last ones still arrive |
| scheduler | the first orders of the new incarnation |
| learner | the first update of the new incarnation |
| launcher | the first frame after `--resume` |

With `--stop` a process is stopped by SIGSTOP. If it is still there when the run works again, it is woken by SIGCONT,
which must have no effect. A stopped launcher is woken after some seconds, and the run must go on.

`tests/chaos/oracle.py` explains the counts; its faults must all be 0.
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
import time
from pathlib import Path

import oracle
import psutil
from oracle import Tail
from small_run import Launcher, Witness, end_cleanly, moments, wait_for

from zsdist.run import restarts
from zsdist.transport.certificates import Identity

ROLES = ("replay", "actor", "hub", "scheduler", "learner")
CALM_S = 1.0  # least time with frames before a kill
WATCH_S = 1.5  # least time after it in which pauses are looked for
PATIENCE_S = 60.0
START_WITHIN_S = 240.0  # on a busy machine
SOON_S = 0.25
STORM_PAUSE_S = (0.2, 2.5)  # between the kills of a storm
STORM_CALM_EVERY = 10  # kills after which a storm waits until the run works
EARLY_SHARE = 0.5  # of a launcher's kills, unless the one before it was early
LAUNCHER_STARTS_S = (0.5, 8.0)  # from the beginning of a start to an early kill
LAUNCHER_LIVES_S = (0.0, 3.0)  # from the first frame of a start to its kill
LAUNCHER_SLEEPS_S = (3.0, 15.0)
MANY = 10**6
TIMES = ("resumed_s", "pauses_s")  # until the run works again; longest time without a frame after the kill


class Killing:
    """Run whose processes are killed, with all that is known of it.

    Args:
        root: folder for the run.
        seed: seed of moments and victims.
        settings: settings of the run.
        restarts_allowed: as `Launcher` has them.
        identity: as `Witness` has it.
    """

    def __init__(
        self,
        root: Path,
        seed: int,
        *settings: str,
        restarts_allowed: int | None = None,
        identity: Identity | None = None,
    ) -> None:
        self.root, self.settings, self.restarts_allowed = root, settings, restarts_allowed
        self.random = moments(seed)
        self.row: dict = {"kills": 0, "resumed_s": [], "pauses_s": [], "alive_after": 0}
        self.standby_kib = 0
        self.launcher = self._start()
        self.tail, self.witness = Tail(self.launcher.folder), Witness(self.launcher, identity)
        self._victims: dict[str, int] = {}  # newest epoch of each role that was killed
        self._killed_s: float | None = None  # time of the last kill of the launcher
        self._early = False  # whether that was before the start had produced anything

    def _start(self) -> Launcher:
        return Launcher(self.root, *self.settings, restarts=self.restarts_allowed)

    def poll(self) -> None:
        """Take in what has happened; raise `AssertionError` where the run has ended."""
        self.witness.poll()
        self.launcher.require_running()

    def wait_for(self, condition, what: str, patience_s: float = PATIENCE_S) -> None:
        """Poll until a condition holds."""
        wait_for(condition, patience_s, what, self.poll)

    def await_calm(self, *, standby: bool) -> None:
        """Wait until frames have been arriving for a while, and a process waits to replace another one."""
        calm_s = CALM_S + self.random.random()
        since_s = time.time()

        def calm() -> bool:
            nonlocal since_s
            now = time.time()
            waiting = self.launcher.standby_kib() if standby else 1
            if now - self.tail.last_s > 0.5 or waiting is None:
                since_s = now
            elif standby:
                self.standby_kib = max(self.standby_kib, waiting)
            return now - since_s > calm_s

        self.wait_for(calm, "a steady flow of frames", START_WITHIN_S)

    def strike(self, role: str, number: int = signal.SIGKILL) -> tuple[str, int, int] | None:
        """Kill or stop a process of a role; return its name, epoch and process; None: none is known to live."""
        names = self.witness.name_of(role)
        living = [name for name in names if self.witness.statistics[name]["epoch"] > self._victims.get(name, -1)]
        if not living:
            return None
        name = self.random.choice(living)
        epoch, pid = (self.witness.statistics[name][field] for field in ("epoch", "pid"))
        self._victims[name] = epoch
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)
        self.row["kills"] += 1
        return name, epoch, pid

    def kill_once(self, role: str, number: int) -> None:
        """Wait for a calm moment, kill or stop a process, and measure the time until the run works again."""
        self.await_calm(standby=True)
        self.wait_for(lambda: any(self._newest(name) for name in self.witness.name_of(role)), f"statistics of a {role}")
        killed_s, newest = time.time(), max(epoch for _, epoch in self.tail.arrivals)
        name, epoch, pid = self.strike(role, number)
        if number == signal.SIGKILL:
            with contextlib.suppress(psutil.NoSuchProcess):
                while psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                    time.sleep(0.0005)
        before = self.tail.read()

        def works() -> bool:
            now = time.time()
            if self.witness.statistics[name]["epoch"] <= epoch or now - killed_s < WATCH_S:
                return False
            return now - self.tail.last_s < 0.5 and self._again(role, name, epoch, killed_s, newest, before) is not None

        self.wait_for(works, f"recovery from the death of {name}")
        after = [killed_s, *(time_s for time_s, _ in self.tail.arrivals[before:])]
        self.row["resumed_s"].append(round(self._again(role, name, epoch, killed_s, newest, before) - killed_s, 4))
        self.row["pauses_s"].append(round(max(later - earlier for earlier, later in itertools.pairwise(after)), 4))
        with contextlib.suppress(ProcessLookupError):
            if number == signal.SIGSTOP:
                self.row["alive_after"] += psutil.pid_exists(pid)
                os.kill(pid, signal.SIGCONT)
        times = f"works after {self.row['resumed_s'][-1]:.3f} s, longest pause {self.row['pauses_s'][-1]:.3f} s"
        print(f"{name} {len(self.row['resumed_s'])}: {times}", file=sys.stderr, flush=True)

    def _newest(self, name: str) -> bool:
        return self.witness.statistics[name]["epoch"] > self._victims.get(name, -1)

    def _again(self, role: str, name: str, epoch: int, killed_s: float, newest: int, before: int) -> float | None:
        """Return the time at which the run worked again; None: it does not yet."""
        after = self.tail.arrivals[before:]
        match role:
            case "scheduler":
                sender, time_s = self.witness.orders
                return time_s if sender > epoch else None
            case "learner":
                sender, time_s = self.witness.updates.get(name.partition("-")[2], (-1, 0.0))
                return time_s if sender > epoch else None
            case "actor":
                return next((time_s for time_s, frame_epoch in after if frame_epoch > newest), None)
            case "replay":
                return after[0][0] if after else None
        times = [killed_s, *(time_s for time_s, _ in after)]
        pauses = [
            (later - earlier, later) for earlier, later in itertools.pairwise(times) if earlier - killed_s < SOON_S
        ]
        return max(pauses)[1] if pauses else None

    def storm(self, kills: int) -> None:
        """Kill random roles, often several before the first of them is replaced."""
        while self.row["kills"] < kills:
            if self.row["kills"] % STORM_CALM_EVERY == 0:
                self.await_calm(standby=False)
            pause_s = self.random.uniform(*STORM_PAUSE_S)
            until_s = time.time() + pause_s
            self.wait_for(lambda until_s=until_s: time.time() > until_s, "the next kill")
            for role in self.random.sample(ROLES, self.random.choice((1, 1, 2, 3))):
                if struck := self.strike(role):
                    self.row.setdefault("by_role", {}).setdefault(role, 0)
                    self.row["by_role"][role] += 1
                    print(f"storm {self.row['kills']}: {struck[0]}", file=sys.stderr, flush=True)

    def kill_launcher(self) -> None:
        """Kill everything of the run, or the launcher alone, at a random moment, and resume it.

        Half of the moments lie after the first frame of a start, the others soon after its beginning, while processes
        start and journals are read. A start that has produced no frame is followed by one that may.
        """
        before = len(self.tail.arrivals)
        early = not self._early and self.random.random() < EARLY_SHARE
        if early:
            until_s = time.time() + self.random.uniform(*LAUNCHER_STARTS_S)
        else:
            self.wait_for(lambda: len(self.tail.arrivals) > before, "the first frame", START_WITHIN_S)
            if self._killed_s is not None:
                self._note_resume(self.tail.arrivals[before][0] - self._killed_s)
            until_s = time.time() + self.random.uniform(*LAUNCHER_LIVES_S)
        self.wait_for(lambda: time.time() > until_s, "the kill", START_WITHIN_S)
        alone, self._early = self.random.random() < 0.5, early
        self.witness.poll()
        if not early:
            self._killed_s = time.time()
        self.launcher.kill(alone=alone)
        self.row["kills"] += 1
        self.row.setdefault("gone_s", []).append(round(self._await_end(), 3))
        self.tail.read()
        self.launcher = self._start()
        self.witness.attach(self.launcher)
        what = f"{'launcher alone' if alone else 'everything'}, {'early' if early else 'later'}"
        print(f"{what}, {self.row['kills']}: resumed after {self.row['resumed_s'][-1:]} s", file=sys.stderr, flush=True)

    def _note_resume(self, seconds: float) -> None:
        """Note the time from a kill to the next frame, unless the start after it was killed too."""
        if not self._early:
            self.row["resumed_s"].append(round(seconds, 3))
            self.row["pauses_s"].append(round(seconds, 3))

    def stop_launcher(self) -> None:
        """Stop the launcher for some seconds, and require that frames come while it sleeps and after it wakes."""
        self.await_calm(standby=True)
        os.kill(self.launcher.process.pid, signal.SIGSTOP)
        stopped_s, sleeps_s = time.time(), self.random.uniform(*LAUNCHER_SLEEPS_S)
        self.wait_for(lambda: time.time() > stopped_s + sleeps_s, "waking")
        os.kill(self.launcher.process.pid, signal.SIGCONT)
        woken_s = time.time()
        self.wait_for(lambda: self.tail.last_s > woken_s, "a frame after waking")
        self.row["kills"] += 1
        self.row["resumed_s"].append(round(self.tail.last_s - woken_s, 3))
        self.row["pauses_s"].append(round(_longest_pause(self.tail, stopped_s), 3))
        print(
            f"launcher {self.row['kills']}: longest pause {self.row['pauses_s'][-1]:.3f} s", file=sys.stderr, flush=True
        )

    def finish(self) -> dict:
        """Interrupt the run, and return all counts."""
        self.await_calm(standby=False)
        status = self.launcher.stop()
        assert status == 128 + signal.SIGINT, f"exit status {status}: {self.launcher.last_words()}"
        self.tail.close()
        self.witness.close()
        summary = json.loads((self.launcher.folder / "summary.json").read_text())
        counts = oracle.verdict(self.launcher, self.tail, self.witness, summary)
        left_s = self._await_end()
        restarted = summary["restarts"]
        return self.row | counts | {"restarts": restarted, "standby_kib": self.standby_kib, "left_s": round(left_s, 2)}

    def _await_end(self) -> float:
        """Wait until no process of the run is left; return the seconds that it took."""
        began_s = time.time()
        while left := self.launcher.left():
            assert time.time() - began_s < PATIENCE_S, f"left are {left}"
            time.sleep(0.05)
        return time.time() - began_s

    def abandon(self) -> None:
        """Kill all that is left of the run; where it has not ended as it should, print what is known of it."""
        if self.launcher.process.poll() is None or sys.exc_info()[0] is not None:
            print(self._report(), file=sys.stderr, flush=True)
        self.witness.close()
        self.launcher.kill(alone=False)

    def _report(self) -> str:
        logs = sorted((self.launcher.folder / "logs").glob("*.log"))
        said = {log.stem: log.read_text(errors="replace").splitlines()[-1:] for log in logs}
        heard = {name: round(time.time() - about["time_s"], 1) for name, about in self.witness.statistics.items()}
        events = self.witness.events[-5:]
        return (
            f"launcher: {self.launcher.last_words()}\nframes: {len(self.tail.arrivals)}\nsilence in s: {heard}\n"
            f"logs: {said}\nevents: {events}"
        )


def _longest_pause(tail: Tail, since_s: float) -> float:
    times = [since_s, *(time_s for time_s, _ in tail.arrivals if time_s > since_s)]
    return max((later - earlier for earlier, later in itertools.pairwise(times)), default=0.0)


def ride(role: str, kills: int, seed: int, *, stop: bool = False) -> dict:
    """Run once with so many kills, and return the results."""
    settings = ("run.actors=2", "replay.shards=2") if role == "all" else ()
    allowed = MANY if role in ("all", "launcher") else None
    with tempfile.TemporaryDirectory(prefix="kills-") as root:
        killing = Killing(Path(root), seed, *settings, restarts_allowed=allowed)
        try:
            if role == "all":
                killing.storm(kills)
            else:
                for _ in range(kills):
                    if role != "launcher":
                        killing.kill_once(role, signal.SIGSTOP if stop else signal.SIGKILL)
                    elif stop:
                        killing.stop_launcher()
                    else:
                        killing.kill_launcher()
            return {"role": role, "stop": stop, "seed": seed} | killing.finish()
        finally:
            killing.abandon()


def main() -> None:
    """Add runs to the results until there are enough kills, and print the figures."""
    end_cleanly()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--role", choices=(*ROLES, "launcher", "all"), required=True)
    parser.add_argument("--stop", action="store_true", help="SIGSTOP instead of SIGKILL")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--per-run", type=int, default=restarts.RESTARTS_ALLOWED)
    parser.add_argument("--results", type=Path, default=Path("runs/kills.jsonl"), help="appended to")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.results.parent.mkdir(parents=True, exist_ok=True)
    while (left := options.kills - _of(options)["kills"]) > 0:
        seed = options.seed + len(_rows(options))
        row = ride(options.role, min(left, options.per_run), seed, stop=options.stop)
        with options.results.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{options.role}: {_of(options)['kills']} kills of {options.kills}", flush=True)
    found = _of(options)
    print(json.dumps(found))
    sys.exit(any(found[name] for name in oracle.FAULTS))


def _rows(options: argparse.Namespace) -> list[dict]:
    lines = options.results.read_text().splitlines() if options.results.exists() else []
    rows = map(json.loads, lines)
    return [row for row in rows if (row["role"], row.get("stop", False)) == (options.role, options.stop)]


def _of(options: argparse.Namespace) -> dict:
    """Return all results of the role together."""
    rows = _rows(options)
    found = {"role": options.role, "stop": options.stop, "runs": len(rows)}
    found |= {name: sum(row[name] for row in rows) for name in ("kills", "alive_after", *oracle.COUNTS)}
    for role in ROLES if options.role == "all" else ():
        found[role] = sum(row["by_role"].get(role, 0) for row in rows)
    for name in (*TIMES, "gone_s"):
        if times := sorted(value for row in rows for value in row.get(name, ())):
            p99 = times[min(len(times) - 1, int(0.99 * len(times)))]
            found[name] = {"median": round(statistics.median(times), 3), "p99": p99, "most": times[-1], "n": len(times)}
    return found | {"standby_kib": max((row["standby_kib"] for row in rows), default=0)}


if __name__ == "__main__":
    main()
