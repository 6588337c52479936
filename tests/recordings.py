"""Recorded sets made by kinematic cars, for tests of what reads them."""

from pathlib import Path

from fakes import FakeVisualAct, LatticeEnv

from zsdist import config
from zsdist.evaluation import recorded_drives
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.recorded_drives import RecordedDrive, RecordingJob
from zsdist.evaluation.workers import Simulation
from zsdist.recording.contract import TransitionContract
from zsdist.recording.recorded_set import RecordedSet, SetManifest, write_manifest
from zsdist.sim.scenes import families

SIMULATION = Simulation(
    make_env=lambda settings, **_: LatticeEnv(config=settings), load_vision=lambda settings: FakeVisualAct()
)


def manifest_of(contender: Contender, pictures: str = "png") -> SetManifest:
    has_levels = recorded_drives.makes_transitions(contender)
    return SetManifest(
        zsdist="1",
        policy=contender.baseline,
        variant="",
        weights_sha256=None,
        scenes="singleton",
        seed=0,
        pictures=pictures,
        camera=contender.config.camera,
        transitions=TransitionContract.of(contender.config) if has_levels else None,
    )


def record(folder: Path, count: int, baseline: str = "astar-vision", settings: config.Config | None = None) -> list:
    """Record `count` episodes into a folder, and return their records."""
    contender = Contender(settings or config.load(overrides=("sim.max_steps=40",)), baseline=baseline)
    folder.mkdir(exist_ok=True)
    manifest = manifest_of(contender)
    write_manifest(folder, manifest)
    drives = [RecordedDrive(number, families.draw("singleton", "test", number)) for number in range(count)]
    job = RecordingJob(contender, manifest, folder, 0, SIMULATION)
    return [record for _, record in recorded_drives.record_each(job, drives, 1)]


def recorded(folder: Path, count: int, **options) -> RecordedSet:
    record(folder, count, **options)
    return RecordedSet(folder)
