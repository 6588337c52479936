"""Whole runs over the memory transport, with kinematic cars in place of the simulation."""

import json
from collections import defaultdict
from pathlib import Path

from fakes import FakeVisualAct, LatticeEnv

from zsdist import config
from zsdist.run import directory, inline, program
from zsdist.run.program import ActorParts, RunSpec
from zsdist.run.scene_schedule import SceneSchedule
from zsdist.transport.base import Mailbox
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire import codec

SMALL = (
    "placement=inline",
    "transport=memory",
    "run.actors=2",
    "run.cars_per_actor=2",
    "run.episodes=8",
    "run.checkpoint_every_episodes=3",
    "run.final_evaluation_episodes=0",
    "sim.max_steps=40",
    "merge.every_episodes=4",
    "merge.validation_scenes=2",
    "merge.distil_updates=4",
    "low.hidden=[16]",
    "high.hidden=[16]",
    "scenes.train=[singleton]",
)
SEEN = VisionIdentity.of(FakeVisualAct(), "head")


def kinematic(settings):
    return ActorParts(lambda: LatticeEnv(config=settings), FakeVisualAct(), SceneSchedule(settings))


class Tap:
    """Recorder of all messages of a run."""

    def __init__(self):
        self.box = Mailbox(2**30)
        self.messages = []
        self.listening = False

    def __call__(self, transport, now):
        if not self.listening:
            transport.subscribe("zsdist/**", self.box, retained=True)
            transport.watch_alive("zsdist/**", self.box)
            self.listening = True
        self.messages += self.box.drain()

    def by_kind(self):
        kinds = defaultdict(list)
        for message in self.messages:
            kind = message.key.split("/")[2]
            if kind in ("stats", "events"):
                kinds[kind].append(json.loads(message.payload))
            elif kind == "alive":
                kinds[kind].append((message.key, message.payload))
            else:
                kinds[kind].append(codec.decode(message.payload))
        return kinds


def start(folder: Path, *overrides: str) -> RunSpec:
    settings = config.load(None, (*SMALL, *overrides))
    folder = directory.create(folder, settings)
    return RunSpec(settings, directory.key_name(folder), folder, {}, SEEN, kinematic)


def resume(folder: Path, *overrides: str) -> RunSpec:
    settings, states = directory.reopen(folder, overrides)
    directory.rewind(folder, settings, states)
    return RunSpec(settings, directory.key_name(folder), folder, states, SEEN, kinematic)


def rehearse(spec: RunSpec, **hooks) -> dict:
    epochs = directory.issue_epochs(spec.folder, program.epoch_count(spec.config))
    inline.run(spec, epochs, **hooks)
    return json.loads((spec.folder / "summary.json").read_text())


def episodes(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "episodes.jsonl").read_text().splitlines()]
