"""Drives an evaluation's episodes, in this process or in several."""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gymnasium
import numpy as np

from zsdist import workers as pool
from zsdist.config import Config
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.drivers import Driver, LearnedDriver, Sees, VisualAct
from zsdist.evaluation.episodes import Examiner
from zsdist.evaluation.metrics import EpisodeRecord
from zsdist.sim.env import CarNavigation
from zsdist.sim.scene import Scene
from zsdist.types import Level, Parameters
from zsdist.vision.visual_act import VisualAct as PretrainedVisualAct


@dataclass(frozen=True)
class Entrant:
    """Who is evaluated, as data that other processes can be sent.

    Attributes:
        config: grid, camera, vision, agent and reward of the policy.
        parameters: of both networks; None for a baseline.
        baseline: its name in the list; empty for a learned policy.
    """

    config: Config
    parameters: dict[Level, Parameters] | None = None
    baseline: str = ""

    @property
    def sees(self) -> Sees:
        """What it is shown."""
        return BASELINES[self.baseline].sees if self.baseline else Sees.CAMERA

    def driver(self, visual_act: VisualAct | None) -> Driver:
        """A driver of its own."""
        if self.baseline:
            return BASELINES[self.baseline].make(self.config, visual_act)
        return LearnedDriver(self.config, self.parameters, visual_act)


@dataclass(frozen=True)
class Simulation:
    """What episodes are driven in."""

    make_env: Callable[[Config], gymnasium.Env] = lambda config: CarNavigation(config=config)
    load_vision: Callable[[Config], VisualAct] = lambda config: PretrainedVisualAct.load(config.vision, config.camera)


def drive_all(
    entrant: Entrant,
    scenes: Sequence[Scene],
    seed: int,
    workers: int,
    on_record: Callable[[EpisodeRecord], None],
) -> list[EpisodeRecord]:
    """Every scene once, in order of the scenes; the result does not depend on the number of workers.

    Args:
        entrant: who drives.
        scenes: what is driven.
        seed: of the drivers' randomness, with the scene's place in the list.
        workers: processes; 1: this one.
        on_record: called here as each episode ends, in the order in which they end.

    Raises:
        ZsdistError: as the episodes do.
        RunError: a worker died.
    """
    drives = list(enumerate(scenes))
    records: list[EpisodeRecord | None] = [None] * len(drives)
    driven = pool.each(_drive, drives, min(workers, len(drives)), _begin, (entrant, seed))
    with contextlib.closing(driven):
        for index, record in driven:
            records[index] = record
            on_record(record)
    return records


def make_examiner(entrant: Entrant, simulation: Simulation | None = None) -> Examiner:
    """The entrant in an environment of its own."""
    simulation = simulation or Simulation()
    visual_act = simulation.load_vision(entrant.config) if entrant.sees is Sees.CAMERA else None
    env = simulation.make_env(entrant.config)
    return Examiner(env, entrant.config, entrant.driver(visual_act), entrant.sees, time.perf_counter)


class _Worker:
    """What a process that drives holds; the examiner is made with the first episode, where its errors are answered."""

    entrant: Entrant
    seed: int
    examiner: Examiner | None = None


def _begin(entrant: Entrant, seed: int) -> None:
    _Worker.entrant, _Worker.seed, _Worker.examiner = entrant, seed, None


def _drive(drive: tuple[int, Scene]) -> tuple[int, EpisodeRecord]:
    index, scene = drive
    if _Worker.examiner is None:
        _Worker.examiner = make_examiner(_Worker.entrant)
    return index, _Worker.examiner.drive(scene, np.random.default_rng([_Worker.seed, index]))
