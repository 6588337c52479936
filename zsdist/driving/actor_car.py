"""One simulated car of an actor: its environment, its agent, and the episode that it drives."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from zsdist.agent.hierarchy import Decision, HierarchicalAgent, QFunctions
from zsdist.agent.recorder import Recorder
from zsdist.config import Config
from zsdist.driving.episode import DrivingEnv, Episode
from zsdist.driving.settings import agent_settings, recorder_settings
from zsdist.types import Level, Pose, Trajectory, View


@dataclass(frozen=True)
class EpisodeTask:
    """Episode to drive, and its purpose.

    Attributes:
        scene: scene, passed to the environment unchanged.
        number: episode number of a training lease, or the index of a validation scene.
        epsilon: probability of an exploratory decision; 0 in drives of candidates.
        shielded: whether the shield masks actions.
        seed: seed of the exploration.
        candidate: name of the candidate that drives; empty in training.
        merge: index of the merge the candidate belongs to.
        most_steps: number of actions after which the drive ends as a timeout, unless the environment ends it earlier.
    """

    scene: Any
    number: int
    epsilon: float
    shielded: bool
    seed: tuple[int, ...]
    candidate: str = ""
    merge: int = 0
    most_steps: float = math.inf

    @property
    def trains(self) -> bool:
        """True for a training episode, whose transitions are learned from."""
        return not self.candidate


@dataclass(frozen=True)
class Glance:
    """Last decision of a car that drives, with the pose and the view on which it rests."""

    pose: Pose
    view: View
    decision: Decision


class CameraEnv(DrivingEnv, Protocol):
    """Environment of a car with a camera."""

    def picture(self, pose: Pose | None = None) -> np.ndarray:
        """Return the camera's picture at the true pose, or for a level car at `pose`, `(px, px, 3)` uint8."""

    def close(self) -> None:
        """Release the simulation."""


@dataclass(frozen=True)
class _Drive:
    """State of a car that drives a task.

    Attributes:
        task: task that is driven.
        episode: episode of the task.
        scene_hash: hash of the scene; None where its readings may not be cached.
        candidate_q: Q-functions of the candidate that drives; None in training.
        versions: versions of the weights at the beginning, by level.
        recorder: recorder of the transitions; None where nothing is learned from them.
    """

    task: EpisodeTask
    episode: Episode
    scene_hash: str | None
    candidate_q: QFunctions | None
    versions: Mapping[Level, int]
    recorder: Recorder | None


class ActorCar:
    """Car that drives one task at a time.

    Once the episode is `over`, one more `advance` observes its last state.

    Args:
        env: simulation of the car.
        config: configuration of the run; grid, simulation, camera, agent and rewards are used.

    Attributes:
        env: simulation of the car.
        agent: agent that decides.
        glance: last decision of the episode; None before the first.
    """

    def __init__(self, env: CameraEnv, config: Config) -> None:
        self.env = env
        self.agent = HierarchicalAgent(agent_settings(config))
        self.glance: Glance | None = None
        self._recorder_settings = recorder_settings(config)
        self._drive: _Drive | None = None

    @property
    def idle(self) -> bool:
        """True while the car has no task."""
        return self._drive is None

    @property
    def task(self) -> EpisodeTask:
        """Task that is driven; it must not be read while the car is idle."""
        return self._driven().task

    @property
    def trains(self) -> bool:
        """True if the task is a training episode."""
        return self._driven().task.trains

    @property
    def over(self) -> bool:
        """True once the episode has ended; its last state may still have to be observed."""
        return self._driven().episode.over

    @property
    def episode(self) -> Episode:
        """Episode that is driven."""
        return self._driven().episode

    @property
    def candidate_q(self) -> QFunctions | None:
        """Q-functions of the candidate that drives; None in training, where the newest networks drive."""
        return self._driven().candidate_q

    @property
    def scene_hash(self) -> str | None:
        """Hash of the scene if its readings may be cached, in training episodes without walkers; else None."""
        return self._driven().scene_hash

    @property
    def pose(self) -> Pose:
        """True pose of the car."""
        return self._driven().episode.pose

    def picture(self, pose: Pose | None = None) -> np.ndarray:
        """Return the camera's picture at the true pose, or for a level car at `pose`, `(px, px, 3)` uint8."""
        return self.env.picture(pose)

    def goal_from_here(self) -> tuple[float, float]:
        """Return the bearing of the goal from the car's axis in radians, left positive, and its distance in metres."""
        return self.pose.towards(*self._driven().episode.goal)

    def begin(self, task: EpisodeTask, versions: Mapping[Level, int], candidate_q: QFunctions | None = None) -> None:
        """Put the car at the start of a task's scene.

        Args:
            task: task to drive.
            versions: versions of the present weights, by level.
            candidate_q: Q-functions of the candidate that drives to the end; None in training.
        """
        episode, self.glance = Episode(self.env, task.scene, task.most_steps), None
        still = task.trains and not task.scene.walkers()
        scene_hash = task.scene.hash() if still else None
        recorder = Recorder(self._recorder_settings, versions) if task.trains else None
        self._drive = _Drive(task, episode, scene_hash, candidate_q, versions, recorder)
        self.agent.begin(
            episode.pose,
            episode.goal,
            epsilon=task.epsilon,
            shielded=task.shielded,
            rng=np.random.default_rng(task.seed),
            recorder=recorder,
        )

    def advance(self, view: View, q: QFunctions) -> None:
        """Observe, decide and drive one action; if the episode is over, observe its last state and finish it."""
        episode = self._driven().episode
        self.agent.observe(episode.pose, view)
        if episode.over:
            self.agent.finish()
        else:
            decision = self.agent.act(q)
            self.glance = Glance(episode.pose, view, decision)
            self.agent.result(*episode.step(int(decision.action)))

    def drain(self) -> list[Trajectory]:
        """Return the trajectories finished since the last call; none where nothing is learned from the task."""
        recorder = self._driven().recorder
        return [] if recorder is None else recorder.drain()

    def cut(self) -> list[Trajectory]:
        """Abort the task; return the trajectories that were not drained yet, closed as truncated.

        The episode does not count.
        """
        self.agent.finish()
        trajectories = self.drain()
        self._drive = None
        return trajectories

    def record(self) -> dict[str, Any]:
        """Return the finished episode as one JSON object, and make the car idle."""
        drive = self._driven()
        task, episode = drive.task, drive.episode
        assert episode.outcome is not None, "only an episode that has ended has a record"
        path = np.asarray([pose[:2] for pose in episode.poses])
        totals = np.asarray(episode.rewards).sum(axis=0)
        self._drive = None
        about = {"episode": task.number} if task.trains else {"scene_index": task.number}
        candidate = {} if task.trains else {"merge": task.merge, "candidate": task.candidate}
        return {
            **about,
            **candidate,
            "scene": task.scene.name,
            "outcome": episode.outcome.value,
            "steps": len(episode.rewards),
            "return": round(float(totals.sum()), 4),
            "return_distance": round(float(totals[0]), 4),
            "return_safety": round(float(totals[1]), 4),
            "return_goal": round(float(totals[2]), 4),
            "path_m": round(float(np.hypot(*np.diff(path, axis=0).T).sum()), 4),
            "epsilon": round(task.epsilon, 4),
            "shielded": task.shielded,
            **{f"{level}_version": version for level, version in drive.versions.items()},
            **self.agent.statistics(),
            "start": [round(float(value), 3) for value in path[0]],
            "goal": [round(value, 3) for value in episode.goal],
            "path": [[round(float(x), 2), round(float(y), 2)] for x, y in path],
        }

    def _driven(self) -> _Drive:
        assert self._drive is not None, "the car is idle"
        return self._drive
