"""The few drives that figures need: greedy episodes of a run's policy, and the shortest way beside them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

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
    """What the figures are drawn from: guidance at home and away, and paths in unseen scenes."""

    guidance: Sequence[Drive]
    paths: Sequence[tuple[Scene, Sequence[DrivenPath]]]


def home_scene(policy: Policy) -> Scene:
    """The first of the scenes that a policy was trained on."""
    return select("train", policy.config, 1, policy.config.seed)[0]


def unseen_scenes(policy: Policy) -> list[Scene]:
    """Scenes of the test families, which no policy is trained on, the families in turn."""
    return select("test", policy.config, UNSEEN_SHOWN, 0)


def drive(policy: Policy, label: str, on_scene: Callable[[str], None], simulation: Simulation | None = None) -> Driven:
    """Drives a training scene and the unseen ones.

    Args:
        policy: drives greedily.
        label: what paths call it.
        on_scene: told the name of each scene before it is driven.
        simulation: in which; None: physics and the camera.
    """
    simulation = simulation or Simulation()
    runner = make_runner(Contender(policy.config, policy.parameters), simulation)
    planner = make_runner(Contender(policy.config, baseline=SHORTEST), simulation)
    visual_act, env = simulation.load_vision(policy.config), simulation.make_env(policy.config)
    home, unseen = home_scene(policy), unseen_scenes(policy)
    guidance, paths = [], []
    for index, scene in enumerate((home, *unseen)):
        on_scene(scene.name)
        moments: list[Moment] = []
        track = _track(runner.drive(scene, np.random.default_rng([0, index]), moments.append), label)
        if index <= 1:
            known = moments[-1].thought.situation
            env.reset(options={"scene": scene})
            values = guidance_of(policy.config, policy.parameters[Level.HIGH], known, env.picture, visual_act)
            guidance.append(Drive(scene, track, values))
        if index:
            shortest = _track(planner.drive(scene, np.random.default_rng(0)), "A*, whole map", reference=True)
            paths.append((scene, (shortest, track)))
    env.close()
    return Driven(guidance, paths)


def _track(record: EpisodeRecord, label: str, reference: bool = False) -> DrivenPath:
    return DrivenPath(np.array(record.poses)[:, :2], record.outcome, label, reference)
