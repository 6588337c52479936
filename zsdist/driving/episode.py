"""One driven episode from reset to outcome, in the form that actors and evaluation share."""

import math
from typing import Any, NamedTuple, Protocol, SupportsFloat

import numpy as np

from zsdist.common import finite
from zsdist.planning.rewards import RewardTerms
from zsdist.types import Outcome, Pose


class DrivingEnv(Protocol):
    """Part of a gymnasium environment that an episode needs."""

    def reset(self, *, options: dict[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode in `options["scene"]` and return its observation, which has `pose` and `goal`, and info."""

    def step(self, action: int) -> tuple[dict[str, np.ndarray], SupportsFloat, bool, bool, dict[str, Any]]:
        """Drive one action to its end; return observation, reward, terminated, truncated and info."""


class StepResult(NamedTuple):
    """Result of one action for agents and drivers.

    Attributes:
        terms: paper rewards of the action.
        outcome: outcome of the episode if the action ended it; else None.
    """

    terms: RewardTerms
    outcome: Outcome | None


class Episode:
    """One episode from its reset to its outcome; the caller chooses the actions.

    Args:
        env: environment to drive in; it is reset here.
        scene: scene, passed to the environment unchanged.
        most_steps: number of actions after which the episode ends as a timeout, unless the environment ends it earlier.

    Attributes:
        observation: last observation of the environment.
        info: last info of the environment.
        poses: true poses so far, the start included.
        rewards: paper rewards of each action so far.
        outcome: outcome of the episode; None before its end.
    """

    def __init__(self, env: DrivingEnv, scene: Any, most_steps: float = math.inf) -> None:
        self._env, self._most_steps = env, most_steps
        self.observation, self.info = env.reset(options={"scene": scene})
        self.poses = [_pose(self.observation)]
        self.rewards: list[RewardTerms] = []
        self.outcome: Outcome | None = None

    @property
    def pose(self) -> Pose:
        """True pose of the car."""
        return self.poses[-1]

    @property
    def goal(self) -> tuple[float, float]:
        """Observed goal `(x_m, y_m)`."""
        x_m, y_m = self.observation["goal"].tolist()
        return x_m, y_m

    @property
    def over(self) -> bool:
        """True once the episode has ended."""
        return self.outcome is not None

    def step(self, action: int) -> StepResult:
        """Drive one action to its end and return its result.

        Raises:
            RunError: the environment returned a pose or a reward that is not finite.
        """
        observation, _, terminated, truncated, info = self._env.step(action)
        terms = RewardTerms(**info["reward_terms"])
        finite.require("pose and rewards of the environment", np.array([*observation["pose"], *terms]))
        self.observation, self.info = observation, info
        self.rewards.append(terms)
        self.poses.append(_pose(self.observation))
        truncated = truncated or len(self.rewards) >= self._most_steps
        if terminated:
            self.outcome = Outcome.SUCCESS if self.info["success"] else Outcome.COLLISION
        elif truncated:
            self.outcome = Outcome.TIMEOUT
        return StepResult(terms, self.outcome)


def _pose(observation: dict[str, np.ndarray]) -> Pose:
    return Pose(*observation["pose"].tolist())
