"""Rewards of the paper, term by term. By default both levels learn from `zsdist.agent.reward_shaping` instead."""

import math
from typing import NamedTuple


class RewardTerms(NamedTuple):
    """Terms of one step's reward: `distance` R_1, `safety` R_2, `goal` R_3."""

    distance: float
    safety: float
    goal: float

    @property
    def total(self) -> float:
        """Reward of the environment: the sum of the three terms."""
        return self.distance + self.safety + self.goal


def target_distance(next_xy: tuple[float, float], target_xy: tuple[float, float]) -> float:
    """Return R_1, minus the Euclidean distance in metres between the car after the step and its target. Eq. (18)."""
    return -math.hypot(next_xy[0] - target_xy[0], next_xy[1] - target_xy[1])


def obstacle_avoidance(collided: bool, collision: float, safe: float) -> float:
    """Return R_2, `collision` if the car collided in the step and `safe` otherwise. Eq. (19)."""
    return collision if collided else safe


def target_reached(reached: bool, goal: float, step: float) -> float:
    """Return R_3, `goal` if the step reached the target and `step` otherwise. Eq. (20).

    Deviation: the target counts as reached within the success radius rather than at exactly equal coordinates.
    """
    return goal if reached else step
