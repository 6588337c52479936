"""Driving of an evaluation's episodes, in this process or in several."""

import contextlib
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import gymnasium

from zsdist.common import process_pool as pool
from zsdist.common import random_streams
from zsdist.config import Config
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Observability, ViewPredictor
from zsdist.evaluation.episodes import EpisodeRunner
from zsdist.evaluation.records import EpisodeRecord
from zsdist.sim.physics.kinematic import make_env
from zsdist.sim.scenes.scene import Scene
from zsdist.vision.visual_act import VisualAct


@dataclass(frozen=True)
class Simulation:
    """Factories of environments and vision, with the signature of `zsdist.sim.physics.kinematic.make_env`."""

    make_env: Callable[..., gymnasium.Env] = make_env
    load_vision: Callable[[Config], ViewPredictor] = lambda config: VisualAct.load(config.vision, config.camera)


def drive_all(
    contender: Contender,
    scenes: Sequence[Scene],
    seed: int,
    workers: int,
    on_record: Callable[[int, EpisodeRecord], None],
    known: Mapping[int, EpisodeRecord] = MappingProxyType({}),
) -> list[EpisodeRecord]:
    """Drive every scene once and return the records in order; they do not depend on the number of workers.

    Args:
        contender: contender to evaluate.
        scenes: scenes to drive.
        seed: seed of the drivers' randomness, combined with the index of the scene.
        workers: number of processes; 1: only this one.
        on_record: called in this process with the index of the scene and the record, as each episode ends.
        known: episodes that were driven before, by the index of their scene; they are not driven again.

    Raises:
        ZsdistError: an episode raised it.
        RunError: a worker died.
    """
    records = dict(known)
    drives = [EvaluationDrive(0, index, scene) for index, scene in enumerate(scenes) if index not in known]
    with contextlib.closing(drive_each([contender], drives, seed, workers)) as driven:
        for drive, record in driven:
            records[drive.number] = record
            on_record(drive.number, record)
    return [records[index] for index in range(len(scenes))]


class EvaluationDrive(NamedTuple):
    """Drive of an evaluation.

    Attributes:
        contender: index of the contender that drives.
        number: index of the scene among those of the contender.
        scene: scene to drive.
    """

    contender: int
    number: int
    scene: Scene


def drive_each(
    contenders: Sequence[Contender], drives: Sequence[EvaluationDrive], seed: int, workers: int
) -> Generator[tuple[EvaluationDrive, EpisodeRecord], None, None]:
    """Yield each drive with its record as it ends; the drives begin in their order, in the same processes.

    A record depends neither on the number of workers nor on the other drives. Close the generator if it may not be
    exhausted.

    Args:
        contenders: contenders to evaluate.
        drives: drives to make; those of one contender should follow one another.
        seed: seed of the drivers' randomness, combined with the index of the scene.
        workers: number of processes; 1: only this one.

    Raises:
        ZsdistError: an episode raised it.
        RunError: a worker died.
    """
    driven = pool.each(_drive, drives, min(workers, len(drives)), _begin, (tuple(contenders), seed))
    with contextlib.closing(driven):
        yield from driven


def make_runner(contender: Contender, simulation: Simulation | None = None, images: bool = False) -> EpisodeRunner:
    """Return a runner of a contender in an environment of its own.

    Args:
        contender: contender to evaluate.
        simulation: simulation to drive in; None: physics and the camera.
        images: whether to render pictures even if the driver does not observe them.
    """
    simulation = simulation or Simulation()
    visual_act = simulation.load_vision(contender.config) if contender.observability is Observability.CAMERA else None
    env = simulation.make_env(
        contender.config, images=images or contender.observability is Observability.CAMERA, exact=contender.exact
    )
    return EpisodeRunner(
        env, contender.config, contender.driver(visual_act), contender.observability, time.perf_counter
    )


class _Worker:
    """State of a worker process. Runners are made in their first episode, since errors of episodes are reported.

    Attributes:
        contenders: all contenders.
        seed: seed of the drivers' randomness.
        runner: runner of the contender that drove last, and the contender's index.
        vision: loaded vision models, by their settings.
    """

    contenders: Sequence[Contender]
    seed: int
    runner: tuple[int, EpisodeRunner] | None
    vision: dict[str, ViewPredictor]


def _begin(contenders: Sequence[Contender], seed: int) -> None:
    _Worker.contenders, _Worker.seed, _Worker.runner, _Worker.vision = contenders, seed, None, {}


def _drive(drive: EvaluationDrive) -> tuple[EvaluationDrive, EpisodeRecord]:
    if _Worker.runner is None or _Worker.runner[0] != drive.contender:
        _Worker.runner = None  # before the next one takes as much memory
        simulation = Simulation(load_vision=_load_once)
        _Worker.runner = drive.contender, make_runner(_Worker.contenders[drive.contender], simulation)
    _, runner = _Worker.runner
    return drive, runner.drive(drive.scene, random_streams.evaluated_episode(_Worker.seed, drive.number))


def _load_once(config: Config) -> ViewPredictor:
    settings = config.model_dump_json(include={"vision", "camera"})
    if settings not in _Worker.vision:
        _Worker.vision[settings] = Simulation().load_vision(config)
    return _Worker.vision[settings]
