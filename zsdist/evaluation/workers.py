"""Drives an evaluation's episodes, in this process or in several."""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import gymnasium
import numpy as np

from zsdist.common import process_pool as pool
from zsdist.config import Config
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.drivers import Observability, VisualAct
from zsdist.evaluation.episodes import EpisodeRunner
from zsdist.evaluation.records import EpisodeRecord
from zsdist.sim.physics.kinematic import make_env
from zsdist.sim.scenes.scene import Scene
from zsdist.vision.visual_act import VisualAct as PretrainedVisualAct


@dataclass(frozen=True)
class Simulation:
    """What episodes are driven in; `make_env` has the arguments of `zsdist.sim.physics.kinematic.make_env`."""

    make_env: Callable[..., gymnasium.Env] = make_env
    load_vision: Callable[[Config], VisualAct] = lambda config: PretrainedVisualAct.load(config.vision, config.camera)


def drive_all(
    contender: Contender,
    scenes: Sequence[Scene],
    seed: int,
    workers: int,
    on_record: Callable[[int, EpisodeRecord], None],
    known: Mapping[int, EpisodeRecord] = MappingProxyType({}),
) -> list[EpisodeRecord]:
    """Every scene once, in order of the scenes; the result does not depend on the number of workers.

    Args:
        contender: who drives.
        scenes: what is driven.
        seed: of the drivers' randomness, with the scene's place in the list.
        workers: processes; 1: this one.
        on_record: called here with its place in the list as each episode ends, in the order in which they end.
        known: episodes by their place in the list that were driven before and are not driven again.

    Raises:
        ZsdistError: as the episodes do.
        RunError: a worker died.
    """
    records = [known.get(index) for index in range(len(scenes))]
    drives = [(index, scene) for index, scene in enumerate(scenes) if records[index] is None]
    driven = pool.each(_drive, drives, min(workers, len(drives)), _begin, (contender, seed))
    with contextlib.closing(driven):
        for index, record in driven:
            records[index] = record
            on_record(index, record)
    return records


def make_examiner(contender: Contender, simulation: Simulation | None = None, images: bool = False) -> EpisodeRunner:
    """The entrant in an environment of its own.

    Args:
        contender: who drives.
        simulation: in which; None: physics and the camera.
        images: whether pictures are wanted although the driver does not see by them.
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
    """What a process that drives holds; the examiner is made with the first episode, where its errors are answered."""

    contender: Contender
    seed: int
    runner: EpisodeRunner | None = None


def _begin(contender: Contender, seed: int) -> None:
    _Worker.contender, _Worker.seed, _Worker.runner = contender, seed, None


def _drive(drive: tuple[int, Scene]) -> tuple[int, EpisodeRecord]:
    index, scene = drive
    if _Worker.runner is None:
        _Worker.runner = make_examiner(_Worker.contender)
    return index, _Worker.runner.drive(scene, np.random.default_rng([_Worker.seed, index]))
