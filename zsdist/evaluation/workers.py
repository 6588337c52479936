"""Drives an evaluation's episodes, in this process or in several."""

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

import gymnasium
import numpy as np

from zsdist.config import Config
from zsdist.errors import RunError
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
    workers = min(workers, len(scenes))
    if workers <= 1:
        examiner = make_examiner(entrant)
        records = []
        for index, scene in enumerate(scenes):
            records.append(examiner.drive(scene, _rng(seed, index)))
            on_record(records[-1])
        return records
    environment = {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    os.environ.update(dict.fromkeys(environment, "1"))
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker, initargs=(entrant,))
    try:
        futures = _submit(pool, scenes, seed)
        for future in as_completed(futures):
            on_record(future.result())
        return [future.result() for future in futures]
    except BrokenProcessPool as error:
        raise RunError("a worker of the evaluation died; with --workers 1 its own message is seen") from error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        for name, value in environment.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def make_examiner(entrant: Entrant, simulation: Simulation | None = None) -> Examiner:
    """The entrant in an environment of its own."""
    simulation = simulation or Simulation()
    visual_act = simulation.load_vision(entrant.config) if entrant.sees is Sees.CAMERA else None
    env = simulation.make_env(entrant.config)
    return Examiner(env, entrant.config, entrant.driver(visual_act), entrant.sees, time.perf_counter)


def _submit(pool: ProcessPoolExecutor, scenes: Sequence[Scene], seed: int) -> list[Future[EpisodeRecord]]:
    """Starts the workers deaf to Ctrl-C, which is the parent's to answer: what is ignored here stays so in them."""
    if threading.current_thread() is not threading.main_thread():
        return [pool.submit(_drive, scene, seed, index) for index, scene in enumerate(scenes)]
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        return [pool.submit(_drive, scene, seed, index) for index, scene in enumerate(scenes)]
    finally:
        signal.signal(signal.SIGINT, handler)


class _Worker:
    """What a worker process holds: the examiner is made with the first episode, where its errors can be answered."""

    entrant: Entrant | None = None
    examiner: Examiner | None = None


def _begin_worker(entrant: Entrant) -> None:
    _Worker.entrant = entrant
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    multiprocessing.connection.wait([multiprocessing.parent_process().sentinel])
    os._exit(1)


def _drive(scene: Scene, seed: int, index: int) -> EpisodeRecord:
    if _Worker.examiner is None:
        _Worker.examiner = make_examiner(_Worker.entrant)
    return _Worker.examiner.drive(scene, _rng(seed, index))


def _rng(seed: int, index: int) -> np.random.Generator:
    return np.random.default_rng([seed, index])
