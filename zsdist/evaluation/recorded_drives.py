"""Recorded drives of an evaluation's drivers, in this process or in several."""

import contextlib
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from zsdist.common import process_pool as pool
from zsdist.common import random_streams
from zsdist.driving.settings import recorder_settings
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Driver
from zsdist.evaluation.episodes import EpisodeRunner, Moment, Watch
from zsdist.evaluation.metrics import scene_entry
from zsdist.evaluation.records import EpisodeRecord
from zsdist.evaluation.workers import Simulation, make_runner
from zsdist.planning.grid import Grid
from zsdist.recording.episode import DriveState, EpisodeFile
from zsdist.recording.recorded_set import SetManifest, describe_file, episode_path
from zsdist.sim.scenes import scene as scene_files
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Outcome


class RecordedDrive(NamedTuple):
    """Drive to record.

    Attributes:
        number: number of the episode in the set.
        scene: scene to drive.
    """

    number: int
    scene: Scene


@dataclass(frozen=True)
class RecordingJob:
    """Set that is recorded.

    Attributes:
        contender: contender that drives.
        manifest: manifest of the set.
        folder: folder of the set.
        seed: seed of the drivers' randomness, combined with the number of the episode.
        simulation: simulation to drive in; None: physics and the camera.
    """

    contender: Contender
    manifest: SetManifest
    folder: Path
    seed: int
    simulation: Simulation | None = None


def makes_transitions(contender: Contender) -> bool:
    """Return whether a contender decides on two levels, so that a learner can use what it does."""
    return contender.driver(None).record(recorder_settings(contender.settings))


def record_each(
    job: RecordingJob, drives: Sequence[RecordedDrive], workers: int
) -> Generator[tuple[RecordedDrive, EpisodeRecord], None, None]:
    """Yield each drive with its record once its file is complete; the drives begin in their order.

    Records are those of an evaluation with the same seed. Close the generator if it may not be exhausted.

    Args:
        job: set that is recorded.
        drives: drives to record.
        workers: number of processes; 1: only this one.

    Raises:
        ZsdistError: an episode raised it.
        RunError: a worker died.
    """
    driven = pool.each(_drive, drives, min(workers, len(drives)), _begin, (job,))
    with contextlib.closing(driven):
        yield from driven


class _Worker:
    """State of a worker process.

    Attributes:
        job: set that is recorded.
        runner: runner of the contender; None before the first episode, whose errors are reported.
    """

    job: RecordingJob
    runner: EpisodeRunner | None


def _begin(job: RecordingJob) -> None:
    _Worker.job, _Worker.runner = job, None


def _drive(drive: RecordedDrive) -> tuple[RecordedDrive, EpisodeRecord]:
    job = _Worker.job
    if _Worker.runner is None:
        _Worker.runner = make_runner(job.contender, job.simulation, images=True)
        if job.manifest.transitions is not None:
            _Worker.runner.driver.record(recorder_settings(job.contender.settings))
    return drive, _record(job, _Worker.runner, drive)


def _record(job: RecordingJob, runner: EpisodeRunner, drive: RecordedDrive) -> EpisodeRecord:
    about = describe_file(job.manifest, drive.number, scene_files.content_of(drive.scene))
    path, grid = episode_path(job.folder, drive.number), Grid.from_config(job.contender.config.grid)
    with EpisodeFile(path, grid, job.manifest.pictures, about, drive.scene.goal) as file:
        rng = random_streams.evaluated_episode(job.seed, drive.number)
        record = runner.drive(drive.scene, rng, _writer(file, runner.driver))
        file.keep({"episode": drive.number, **scene_entry(record)})
    return record


def _writer(file: EpisodeFile, driver: Driver) -> Watch:
    """Return a watcher that writes an episode into its file."""

    def write(moment: Moment) -> None:
        sight = _sight(moment)
        if moment.rewards is not None:
            terms = moment.rewards
            file.result(sight, (terms.distance, terms.safety, terms.goal), _ended(moment.outcome))
        if moment.action is None:
            file.end(sight)
            file.transitions(driver.drain(moment.observed), moment.time_s)
        else:
            file.act(sight, moment.action)
            file.transitions(driver.drain(), moment.time_s)

    return write


def _sight(moment: Moment) -> DriveState:
    """Return what is recorded of a moment; the map of a decision, since there is none after the last."""
    observed = moment.observed
    assert observed.image is not None, "pictures are rendered for every driver that is recorded"
    if moment.action is None or moment.thought is None:
        return DriveState(moment.time_s, observed.image, observed.pose)
    situation = moment.thought.situation
    return DriveState(moment.time_s, observed.image, observed.pose, situation.occupied, situation.seen)


def _ended(outcome: Outcome | None) -> str:
    if outcome is None:
        return ""
    return "truncated" if outcome is Outcome.TIMEOUT else "terminated"
