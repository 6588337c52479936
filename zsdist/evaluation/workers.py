"""Driving of an evaluation's episodes, in this process or in several."""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

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
    drives = [(index, scene) for index, scene in enumerate(scenes) if index not in known]
    driven = pool.each(_drive, drives, min(workers, len(drives)), _begin, (contender, seed))
    with contextlib.closing(driven):
        for index, record in driven:
            records[index] = record
            on_record(index, record)
    return [records[index] for index in range(len(scenes))]


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
    """State of a worker process. The runner is made in the first episode, since errors of episodes are reported."""

    contender: Contender
    seed: int
    runner: EpisodeRunner | None = None


def _begin(contender: Contender, seed: int) -> None:
    _Worker.contender, _Worker.seed, _Worker.runner = contender, seed, None


def _drive(drive: tuple[int, Scene]) -> tuple[int, EpisodeRecord]:
    index, scene = drive
    if _Worker.runner is None:
        _Worker.runner = make_runner(_Worker.contender)
    return index, _Worker.runner.drive(scene, random_streams.evaluated_episode(_Worker.seed, index))
