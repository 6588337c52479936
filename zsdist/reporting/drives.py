"""Greedy episodes of a run's policy for the figures, with the shortest path for comparison."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zsdist.common import random_streams
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.episodes import Moment
from zsdist.evaluation.records import EpisodeRecord
from zsdist.evaluation.selection import select
from zsdist.evaluation.workers import Simulation, make_runner
from zsdist.reporting.guidance import Drive, guidance_of
from zsdist.reporting.maps import DrivenPath
from zsdist.run.checkpoint import Policy
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Level

UNSEEN_SHOWN = 6
SHORTEST = "astar"


@dataclass(frozen=True)
class Driven:
    """Driven episodes for the figures.

    Attributes:
        guidance: drives with guidance in a training scene and in an unseen scene.
        paths: shortest path and path of the policy in each unseen scene.
    """

    guidance: Sequence[Drive]
    paths: Sequence[tuple[Scene, Sequence[DrivenPath]]]


def home_scene(policy: Policy) -> Scene:
    """Return the first of the scenes that a policy was trained on."""
    return select("train", policy.config, 1, policy.config.seed)[0]


def unseen_scenes(policy: Policy) -> list[Scene]:
    """Return scenes of the test families in turn, which no policy is trained on."""
    return select("test", policy.config, UNSEEN_SHOWN, 0)


def drive(policy: Policy, label: str, on_scene: Callable[[str], None], simulation: Simulation | None = None) -> Driven:
    """Drive the training scene and the unseen ones.

    Args:
        policy: policy that drives greedily.
        label: label of its paths.
        on_scene: called with the name of each scene before it is driven.
        simulation: simulation to drive in; None: physics and the camera.
    """
    simulation = simulation or Simulation()
    runner = make_runner(Contender(policy.config, policy.parameters), simulation)
    planner = make_runner(Contender(policy.config, baseline=SHORTEST), simulation)
    visual_act = simulation.load_vision(policy.config)
    env: Any = simulation.make_env(policy.config)  # beyond a gymnasium environment, it has `picture`
    home, unseen = home_scene(policy), unseen_scenes(policy)
    guidance, paths = [], []
    for index, scene in enumerate((home, *unseen)):
        on_scene(scene.name)
        moments: list[Moment] = []
        path = _path(runner.drive(scene, random_streams.evaluated_episode(0, index), moments.append), label)
        if index <= 1:
            thought = moments[-1].thought
            assert thought is not None, "a learned policy records its thoughts"
            env.reset(options={"scene": scene})
            values = guidance_of(
                policy.config, policy.parameters[Level.HIGH], thought.situation, env.picture, visual_act
            )
            guidance.append(Drive(scene, path, values))
        if index:
            shortest = _path(planner.drive(scene, np.random.default_rng(0)), "A*, whole map", reference=True)
            paths.append((scene, (shortest, path)))
    env.close()
    return Driven(guidance, paths)


def _path(record: EpisodeRecord, label: str, reference: bool = False) -> DrivenPath:
    return DrivenPath(np.array(record.poses)[:, :2], record.outcome, label, reference)
