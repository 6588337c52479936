"""Measurement of the time until a real run goes on after a process of it was killed or stopped.

`python tests/revival.py --role learner [--signal STOP] [--kills 10]`

Processes, hub and files are real, under the supervisor of `zsdist.launch`; only the cars are kinematic. A kill hits the
role's process once it works and a standby waits. The run *goes on* with the first progress that a successor reports:
an update of a learner, an episode counted by a scheduler, a transition stored by a replay, a step of an actor; for a
hub, the first progress of a learner that is reported through its successor. Statistics come twice a second, so times
are up to half a second too long.
"""

import argparse
import contextlib
import json
import os
import signal
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])

import psutil
from fakes import FakeVisualAct, LatticeEnv

from zsdist import config
from zsdist.run import directory, program, ray
from zsdist.run.program import ActorParts, RunSpec
from zsdist.run.scene_schedule import SceneSchedule
from zsdist.transport.base import Mailbox, Transport
from zsdist.vision.fingerprint import VisionIdentity

SETTINGS = (
    "transport.endpoint=tcp/127.0.0.1:7800",
    "run.actors=1",
    "run.cars_per_actor=2",
    "run.episodes=100000",
    "run.checkpoint_every_episodes=100000",
    "run.final_evaluation_episodes=0",
    "sim.max_steps=40",
    "merge.every_episodes=0",
    "low.hidden=[16]",
    "high.hidden=[16]",
    "scenes.train=[singleton]",
)
PROGRESS = {
    "learner": "learner_updates",
    "scheduler": "episodes",
    "replay": "low_stored",
    "actor": "env_steps",
    "hub": "learner_updates",
}
CALM_S = 2.0
PATIENCE_S = 90.0


class Blow(NamedTuple):
    """Signal to the process of one role."""

    role: str
    identifier: str
    number: int = signal.SIGKILL


class Revival:
    """Observer of a run that deals blows, one after another, and measures how long the work of each role stops.

    Attributes:
        found_s: time from each kill until a successor has published something.
        resumed_s: time from each kill until it has made progress.
        events: names of events with the roles they are about.
    """

    def __init__(self, run: str, blows: Sequence[Blow]) -> None:
        self.blows = list(blows)
        self.found_s: list[float] = []
        self.resumed_s: list[float] = []
        self.events: list[tuple[str, str]] = []
        self.statistics: dict[tuple[str, str], dict] = {}
        self._run, self._box = run, Mailbox(2**26)
        self._subscribed = False
        self._killed_s: float | None = None
        self._victim = self._begun = None
        self._calm_s = time.monotonic()
        self._least: float | None = None

    def interrupted(self) -> bool:
        """Return whether all blows are dealt, and the run goes on."""
        return len(self.resumed_s) == len(self.blows)

    @property
    def _blow(self) -> Blow:
        return self.blows[min(len(self.resumed_s), len(self.blows) - 1)]

    def watch(self, transport: Transport, now: float) -> None:
        """Read messages, and kill or measure; the runner calls it several times a second."""
        if not self._subscribed:
            self._subscribed = True
            transport.subscribe(f"zsdist/{self._run}/stats/**", self._box)
            transport.subscribe(f"zsdist/{self._run}/events", self._box)
        for message in self._box.drain():
            fields = json.loads(message.payload)
            if "event" in fields:
                self.events.append((fields["event"], fields.get("name", "")))
            else:
                self.statistics[fields["role"], fields["id"]] = fields
                self._note(fields, time.monotonic())
        if self._killed_s is None and not self.interrupted():
            self._kill(time.monotonic())
        assert self._killed_s is None or time.monotonic() - self._killed_s < PATIENCE_S, f"not back: {self._blow}"

    def _kill(self, now: float) -> None:
        role, identifier, number = self._blow
        victim = self.statistics.get((role, identifier), {})
        if not standby_waits() or not self._works(victim):
            self._calm_s = now
        elif now - self._calm_s > CALM_S:
            self._victim, self._killed_s, self._begun = victim["pid"], now, None
            os.kill(victim["pid"], number)

    def _works(self, victim: dict) -> bool:
        name = PROGRESS[self._blow.role]
        watched = victim if self._blow.role != "hub" else self.statistics.get(("learner", "low"), {})
        return bool(victim) and victim["pid"] != self._victim and watched.get(name, 0) > 0

    def _note(self, fields: dict, now: float) -> None:
        """Measure, with statistics that have just arrived."""
        if self._killed_s is None:
            return
        role, identifier, number = self._blow
        if (fields["role"], fields["id"]) == (role, identifier):
            if fields["pid"] == self._victim:
                return
            if self._begun is None:
                self._begun, self._least = now, fields.get(PROGRESS[role])
                self.found_s.append(now - self._killed_s)
        watched = ("learner", "low") if role == "hub" else (role, identifier)
        if self._begun is None or (fields["role"], fields["id"]) != watched:
            return
        progress = fields.get(PROGRESS[role], 0)
        if self._least is None:
            self._least = progress
        elif progress > self._least:
            self.resumed_s.append(now - self._killed_s)
            self._killed_s, self._calm_s, self._least = None, now, None
            times = f"back after {self.found_s[-1]:.2f} s, goes on after {self.resumed_s[-1]:.2f} s"
            print(f"{role} {signal.Signals(number).name}: {times}", flush=True)


def kinematic(settings: config.Config) -> ActorParts:
    """Return the parts of an actor; not those of tests/rehearsal.py, with which a standby would load torch."""
    return ActorParts(lambda: LatticeEnv(config=settings), FakeVisualAct(), SceneSchedule(settings))


def standby_waits() -> bool:
    """Return whether a standby process has warmed up."""
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if " ".join(process.cmdline()).strip() == "ray::NodeHost":
                return True
    return False


def ride(folder: Path, revival: Revival, *overrides: str) -> dict:
    """Run until all kills are done; return the summary of the run."""
    settings = config.load(None, (*SETTINGS, *overrides))
    directory.create(folder, settings)
    seen = VisionIdentity.of(FakeVisualAct(), "head")
    spec = RunSpec(settings, directory.key_name(folder), folder, {}, seen, kinematic)
    epochs = directory.issue_epochs(folder, program.epoch_count(settings))
    ray.run(spec, epochs, interrupted=revival.interrupted, watch=revival.watch)
    return json.loads((folder / "summary.json").read_text())


def main() -> None:
    """Kill or stop processes of a role, and print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--role", choices=list(PROGRESS), required=True)
    parser.add_argument("--signal", choices=["KILL", "STOP"], default="KILL")
    parser.add_argument("--kills", type=int, default=10)
    options = parser.parse_args()
    identifier = "low" if options.role == "learner" else "0"
    with tempfile.TemporaryDirectory() as root:
        number = getattr(signal, f"SIG{options.signal}")
        revival = Revival("revivals", [Blow(options.role, identifier, number)] * options.kills)
        summary = ride(Path(root) / "revivals", revival)
    for name in ("found_s", "resumed_s"):
        times = sorted(getattr(revival, name))
        print(f"{options.role} {options.signal} {name}: median {statistics.median(times):.2f}, most {times[-1]:.2f}")
    print(json.dumps({"restarts": summary["restarts"], "transitions": summary["transitions"]}))


if __name__ == "__main__":
    main()
