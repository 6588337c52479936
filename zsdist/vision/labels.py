"""Labels of an image for the visual-act head: clearance, dynamic or static, and the reward label of each action.

The three directions are those of the actions forward, left and right, in the order of `types.Action`.
"""

from typing import TYPE_CHECKING, TypeVar

import numpy as np

if TYPE_CHECKING:
    import torch

Array = TypeVar("Array", np.ndarray, "torch.Tensor")

DIRECTIONS = ("forward", "left", "right")
HEADINGS_RAD = np.array([0.0, np.pi / 4, -np.pi / 4])
"""Direction of each action from the car's heading, left positive."""

SECTOR_HALF_RAD = np.pi / 12  # forward is the middle third of a view of 90 degrees, left and right are the rest
STOP_M = 0.75  # clearance of this or less has openness 0
FREE_M = 4.0  # clearance of this or more has openness 1
DYNAMIC_EXTRA_M = 0.75  # added to both for an obstacle that moves
OPENNESS_WEIGHT = 0.6  # weight of openness in a reward label; the rest is the weight of progress
GOAL_BEARING_SPREAD_RAD = 1.0
GOAL_DISTANCE_M = (0.7, 14.0)
STEP_M = 1.0  # progress is measured over a step of this length


def sectors(ray_angles_rad: np.ndarray) -> np.ndarray:
    """Return the rays `(R,)` that belong to each direction, `(3, R)` bool."""
    left, right = ray_angles_rad > SECTOR_HALF_RAD, ray_angles_rad < -SECTOR_HALF_RAD
    return np.stack([~left & ~right, left, right])


def nearest(
    ray_distance_m: np.ndarray, ray_dynamic: np.ndarray, ray_angles_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest obstacle in each direction: distance `(..., 3)` in metres, and whether its kind moves.

    Args:
        ray_distance_m: `(..., R)` true distance along each ray, capped at the camera's range.
        ray_dynamic: `(..., R)` bool, whether the ray meets an object of a kind that moves.
        ray_angles_rad: `(R,)`, angles of the rays, left positive.
    """
    clearance, dynamic = [], []
    for sector in sectors(ray_angles_rad):
        distance = ray_distance_m[..., sector]
        index = distance.argmin(-1)[..., None]
        clearance.append(np.take_along_axis(distance, index, -1)[..., 0])
        dynamic.append(np.take_along_axis(ray_dynamic[..., sector], index, -1)[..., 0])
    return np.stack(clearance, -1).astype(np.float32), np.stack(dynamic, -1)


def openness(clearance_m: Array, dynamic: Array, goal_distance_m: Array) -> Array:
    """Return the openness of a direction, from 0 (blocked) to 1 (free); numpy arrays and torch tensors alike.

    Clearance beyond the goal has no value, so less of it suffices near the goal.

    Args:
        clearance_m: distance to the nearest obstacle.
        dynamic: 1 if the kind of that obstacle moves, else 0; or the probability that it does.
        goal_distance_m: distance to the goal.
    """
    stop = STOP_M + DYNAMIC_EXTRA_M * dynamic
    wanted = goal_distance_m.clip(0.5, FREE_M - STOP_M)
    return ((clearance_m - stop) / wanted).clip(0.0, 1.0)


def progress(goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> np.ndarray:
    """Return the approach to the goal by a step in each direction, `(..., 3)` in steps, from -1 to 1.

    Args:
        goal_bearing_rad: `(...)` direction of the goal from the car's heading, left positive.
        goal_distance_m: `(...)`, distance of the goal.
    """
    distance = np.asarray(goal_distance_m)[..., None]
    turn = np.asarray(goal_bearing_rad)[..., None] - HEADINGS_RAD
    after = np.sqrt(np.maximum(distance**2 + STEP_M**2 - 2 * distance * STEP_M * np.cos(turn), 0.0))
    return ((distance - after) / STEP_M).astype(np.float32)


def reward_label(openness_of_action: Array, progress_of_action: Array) -> Array:
    """Return the reward label of an action, Eq. (3), `r_a = f(d_obs, d_g, type_obs)`, from -2 to 2.

    `f` is a weighted sum of `progress` (the change of d_g over a step in the action's direction, -1 to 1) and of
    `openness` (of d_obs and type_obs) mapped to -1 to 1. Its scale is that of the paper's example, [2, -1, -1].
    Openness has the larger weight, so that neither the goal alone nor the image alone determines the best action. At
    inference the goal is known and the head supplies d_obs and type_obs.
    """
    return 2.0 * ((1.0 - OPENNESS_WEIGHT) * progress_of_action + OPENNESS_WEIGHT * (2.0 * openness_of_action - 1.0))


def expected_openness(probabilities: Array, centres_m: Array, dynamic: Array, goal_distance_m: Array) -> Array:
    """Return the mean of `openness` over a distribution of the clearance, `(B, 3)`; numpy and torch alike.

    Args:
        probabilities: `(B, 3, K)` over bins of distance.
        centres_m: `(K,)` the distance that each bin represents.
        dynamic: `(B, 3)` probability that the kind of the obstacle moves.
        goal_distance_m: `(B,)`, distance of the goal.
    """
    return (probabilities * openness(centres_m, dynamic[..., None], goal_distance_m[:, None, None])).sum(-1)


def random_goals(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return bearings `(count,)` in radians, mostly ahead, and distances `(count,)` in metres of random goals."""
    bearing = GOAL_BEARING_SPREAD_RAD * rng.standard_normal(count)
    return bearing.astype(np.float32), rng.uniform(*GOAL_DISTANCE_M, count).astype(np.float32)
