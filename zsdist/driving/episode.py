"""One simulated car of an actor: its environment, its agent, and what it is driving for."""

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from zsdist.agent.hierarchy import HierarchicalAgent, QFunctions
from zsdist.planning.rewards import RewardTerms
from zsdist.types import Level, Outcome, Pose, View


@dataclass(frozen=True)
class EpisodeTask:
    """Why a car drives.

    Attributes:
        scene: handed to the environment as it is.
        number: episode number of a training lease, or the index of a validation scene.
        epsilon: share of exploratory decisions; 0 in evaluation drives.
        shielded: whether the shield masks actions.
        seed: of the exploration.
        candidate: name of the driven candidate, empty in training.
        merge: index of the merge the candidate belongs to.
        most_steps: actions after which the drive ends as a timeout, where the environment does not end it before.
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
        """Whether its transitions are learned from."""
        return not self.candidate


class CameraEnv(Protocol):
    """A gymnasium environment, of which this is used, and the camera of its car."""

    def reset(self, *, options: dict[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Starts an episode in `options["scene"]`; the observation has `pose` and `goal`."""

    def step(self, action: int) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drives one action to its end."""

    def picture(self, pose: Pose | None = None) -> np.ndarray:
        """What the camera sees at the true pose, or on a level car at `pose`."""

    def close(self) -> None:
        """Lets go of the simulation."""


class Car:
    """Drives one errand at a time; `over` once the episode has ended and its last state has been seen."""

    def __init__(self, env: CameraEnv, agent: HierarchicalAgent) -> None:
        self.env = env
        self.agent = agent
        self.task: EpisodeTask | None = None
        self.candidate_q: QFunctions | None = None
        self.credit = dict.fromkeys(Level, 0)  # reserved of the actor's credit and not yet used up, by level
        self.unoffered = dict.fromkeys(Level, 0)  # transitions lived through whose trajectory is not complete yet
        self._observation: dict[str, np.ndarray] = {}
        self._scene_hash: str | None = None
        self._outcome: Outcome | None = None
        self._terms: list[RewardTerms] = []
        self._path: list[tuple[float, float]] = []
        self._versions: dict[str, int] = {}

    @property
    def scene_hash(self) -> str | None:
        """Of the scene, where what is seen in it may be remembered: in training, and where nobody walks."""
        return self._scene_hash

    def picture(self, pose: Pose | None = None) -> np.ndarray:
        """The camera's picture at the true pose, or of a level car at `pose`, `(px, px, 3)` uint8."""
        return self.env.picture(pose)

    @property
    def pose(self) -> Pose:
        """The true pose."""
        return Pose(*self._observation["pose"].tolist())

    def goal_seen_from_here(self) -> tuple[float, float]:
        """Bearing of the goal from the car's axis in radians, left positive, and its distance in metres."""
        return self.pose.towards(*self._observation["goal"].tolist())

    def begin(self, task: EpisodeTask, versions: dict[Level, int], candidate_q: QFunctions | None = None) -> None:
        """Puts the car at the start of its errand's scene; a candidate's networks stay the same to the end."""
        self.task = task
        self.candidate_q = candidate_q
        self._observation, _ = self.env.reset(options={"scene": task.scene})
        still = task.trains and not task.scene.walkers()
        self._scene_hash = task.scene.hash() if still else None
        self._outcome, self._terms = None, []
        self._path = [self.pose[:2]]
        self._versions = {f"{level}_version": version for level, version in versions.items()}
        self.agent.begin(
            self.pose,
            tuple(self._observation["goal"]),
            epsilon=task.epsilon,
            shielded=task.shielded,
            rng=np.random.default_rng(task.seed),
            weight_versions=versions,
            learning=task.trains,
        )

    def advance(self, view: View, q: QFunctions) -> None:
        """One action: see, decide, drive; or, where the episode has ended, see its last state and close it."""
        self.agent.observe(self.pose, view)
        if self.over:
            self.agent.finish()
            return
        decision = self.agent.act(q)
        self._observation, _, terminated, truncated, info = self.env.step(int(decision.action))
        terms = RewardTerms(**info["reward_terms"])
        self._terms.append(terms)
        self._path.append(self.pose[:2])
        truncated = truncated or len(self._terms) >= self.task.most_steps
        self.agent.result(terms, terminated, truncated)
        if terminated:
            self._outcome = Outcome.SUCCESS if info["success"] else Outcome.COLLISION
        elif truncated:
            self._outcome = Outcome.TIMEOUT

    @property
    def over(self) -> bool:
        """Whether the episode has ended; its last state may still be to be seen."""
        return self._outcome is not None

    def cut(self) -> None:
        """Ends the episode here: what was driven is kept as truncated, the episode does not count."""
        self.agent.finish()
        self.task = None

    def record(self) -> dict[str, Any]:
        """The finished episode as one JSON object, and the car free for its next errand."""
        task, path = self.task, np.asarray(self._path)
        totals = np.asarray(self._terms).sum(axis=0)
        self.task = None
        about = {"episode": task.number} if task.trains else {"scene_index": task.number}
        if not task.trains:
            about |= {"merge": task.merge, "candidate": task.candidate}
        return about | {
            "scene": task.scene.name,
            "outcome": self._outcome.value,
            "steps": len(self._terms),
            "return": round(float(totals.sum()), 4),
            "return_distance": round(float(totals[0]), 4),
            "return_safety": round(float(totals[1]), 4),
            "return_goal": round(float(totals[2]), 4),
            "path_m": round(float(np.hypot(*np.diff(path, axis=0).T).sum()), 4),
            "epsilon": round(task.epsilon, 4),
            "shielded": task.shielded,
            **self._versions,
            **self.agent.statistics(),
            "start": [round(float(value), 3) for value in path[0]],
            "goal": [round(float(value), 3) for value in self._observation["goal"]],
            "path": [[round(float(x), 2), round(float(y), 2)] for x, y in path],
        }
