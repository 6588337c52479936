"""What the visual-act head learns to say of an image: clearance, dynamic or static, and each action's reward label.

The three directions are those of the actions forward, left and right, in the order of `types.Action`.
"""

from typing import TypeVar

import numpy as np

Array = TypeVar("Array")  # a numpy array or a torch tensor

DIRECTIONS = ("forward", "left", "right")
HEADINGS_RAD = np.array([0.0, np.pi / 4, -np.pi / 4])
"""Where each action leads, from the car's heading, left positive."""

SECTOR_HALF_RAD = np.pi / 12  # forward is the middle third of a view of 90 degrees, left and right are what is beyond
STOP_M = 0.75  # room of this much or less is none
FREE_M = 4.0  # room of this much or more is all one can wish for
DYNAMIC_EXTRA_M = 0.75  # something that walks asks for so much more of both
OPENNESS_WEIGHT = 0.6  # of a reward label; the rest is for progress
GOAL_BEARING_SPREAD_RAD = 1.0
GOAL_DISTANCE_M = (0.7, 14.0)
STEP_M = 1.0  # progress is measured over a step of this length


def sectors(ray_angles_rad: np.ndarray) -> np.ndarray:
    """Which rays `(R,)` belong to each direction: `(3, R)` bool."""
    left, right = ray_angles_rad > SECTOR_HALF_RAD, ray_angles_rad < -SECTOR_HALF_RAD
    return np.stack([~left & ~right, left, right])


def nearest(
    ray_distance_m: np.ndarray, ray_dynamic: np.ndarray, ray_angles_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest obstacle of each direction: its distance `(..., 3)` in metres and whether it is one that moves.

    Args:
        ray_distance_m: `(..., R)` true distance along each ray, capped at the camera's range.
        ray_dynamic: `(..., R)` bool, whether what the ray meets is of a kind that moves.
        ray_angles_rad: `(R,)`.
    """
    clearance, dynamic = [], []
    for sector in sectors(ray_angles_rad):
        distance = ray_distance_m[..., sector]
        index = distance.argmin(-1)[..., None]
        clearance.append(np.take_along_axis(distance, index, -1)[..., 0])
        dynamic.append(np.take_along_axis(ray_dynamic[..., sector], index, -1)[..., 0])
    return np.stack(clearance, -1).astype(np.float32), np.stack(dynamic, -1)


def openness(clearance_m: Array, dynamic: Array, goal_distance_m: Array) -> Array:
    """Room in a direction, from 0 (none) to 1 (all one can wish for); numpy arrays and torch tensors alike.

    Room beyond the goal is worth nothing, so near the goal less of it is enough.

    Args:
        clearance_m: distance to the nearest obstacle.
        dynamic: 1 where that obstacle is of a kind that moves, else 0; or the probability of it.
        goal_distance_m: distance to the goal.
    """
    stop = STOP_M + DYNAMIC_EXTRA_M * dynamic
    wanted = goal_distance_m.clip(0.5, FREE_M - STOP_M)
    return ((clearance_m - stop) / wanted).clip(0.0, 1.0)


def progress(goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> np.ndarray:
    """How much nearer the goal a step in each direction leads, `(..., 3)` in steps, from -1 to 1.

    Args:
        goal_bearing_rad: `(...)` direction of the goal from the car's heading, left positive.
        goal_distance_m: `(...)`.
    """
    distance = np.asarray(goal_distance_m)[..., None]
    turn = np.asarray(goal_bearing_rad)[..., None] - HEADINGS_RAD
    after = np.sqrt(np.maximum(distance**2 + STEP_M**2 - 2 * distance * STEP_M * np.cos(turn), 0.0))
    return ((distance - after) / STEP_M).astype(np.float32)


def reward_label(openness_of_action: Array, progress_of_action: Array) -> Array:
    """The reward label of an action, Eq. (3), `r_a = f(d_obs, d_g, type_obs)`, from -2 to 2.

    `f` is a weighted sum of `progress` (the change of d_g over a step in the action's direction, -1 to 1) and of
    `openness` (of d_obs and type_obs) mapped to -1 to 1, of the size of the paper's example, [2, -1, -1]. Room
    counts for more than the goal's direction, so that the goal alone does not tell the best action, nor the image
    alone. At inference the goal is known and the head supplies d_obs and type_obs.
    """
    return 2.0 * ((1.0 - OPENNESS_WEIGHT) * progress_of_action + OPENNESS_WEIGHT * (2.0 * openness_of_action - 1.0))


def expected_openness(probabilities: Array, centres_m: Array, dynamic: Array, goal_distance_m: Array) -> Array:
    """The mean of `openness` over a distribution of the clearance, `(B, 3)`; numpy and torch alike.

    Args:
        probabilities: `(B, 3, K)` over bins of distance.
        centres_m: `(K,)` the distance each bin stands for.
        dynamic: `(B, 3)` probability that the obstacle is of a kind that moves.
        goal_distance_m: `(B,)`.
    """
    return (probabilities * openness(centres_m, dynamic[..., None], goal_distance_m[:, None, None])).sum(-1)


def random_goals(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Bearings `(count,)` in radians, mostly ahead, and distances `(count,)` in metres of goals nobody drives to."""
    bearing = GOAL_BEARING_SPREAD_RAD * rng.standard_normal(count)
    return bearing.astype(np.float32), rng.uniform(*GOAL_DISTANCE_M, count).astype(np.float32)
