"""Scores of the vision model's outputs: the best action that they imply, and the distances along rays."""

import numpy as np

MISS_M = (1.5, 2.5)  # a miss: the true distance is below the first, the predicted one above the second
FALSE_ALARM_M = (3.5, 2.0)  # a false alarm: the true distance is above the first, the predicted one below the second
NEAR_OBJECT_M = 2.5  # an object counts if its nearest point in view is nearer than this
UNSEEN_BEYOND_M = 1.0  # an object is unseen if all predictions along its rays are too long by more than this
LEAST_RAYS = 2  # an object on fewer rays does not count: it is too narrow, or too little of it is in view


def action_scores(predicted: np.ndarray, labels: np.ndarray) -> dict[str, float]:
    """Return scores of predicted rewards `(N, 3)` against the true labels `(N, 3)`.

    Returns:
        `best_action_accuracy`: share of images on which the action of the highest prediction is a best one (labels
        within 0.001 of the maximum are all best); `regret`: mean loss of true label by taking the action of the
        highest prediction; `mae`: mean absolute error of the rewards.
    """
    best = labels.max(1)
    gained = np.take_along_axis(labels, predicted.argmax(1)[:, None], 1)[:, 0]
    return {
        "best_action_accuracy": float(np.mean(gained >= best - 1e-3)),
        "regret": float(np.mean(best - gained)),
        "mae": float(np.abs(predicted - labels).mean()),
    }


def ray_scores(predicted_m: np.ndarray, true_m: np.ndarray) -> dict[str, float]:
    """Return rates of misses and false alarms of distances `(N, R)`, over the rays on which each can happen."""
    near, far = true_m < MISS_M[0], true_m > FALSE_ALARM_M[0]
    return {
        "miss_rate": float(np.sum(near & (predicted_m > MISS_M[1])) / max(near.sum(), 1)),
        "false_alarm_rate": float(np.sum(far & (predicted_m < FALSE_ALARM_M[1])) / max(far.sum(), 1)),
    }


def calibration(quantile_m: np.ndarray, true_m: np.ndarray, range_m: float) -> dict[str, float]:
    """Return how often the truth lies below a quantile; for a calibrated model that is the quantile's share.

    Args:
        quantile_m: `(N, R)`, quantile of the predicted distances, at most `range_m`.
        true_m: `(N, R)`, true distances, capped at `range_m`.
        range_m: range of the camera, in metres.

    Returns:
        `short`: the share over rays whose quantile is below the range, NaN if there is none; `all`: the share over all
        rays (the truth is never below a quantile that equals the range); `rays`: number of rays with a quantile below
        the range.
    """
    below, short = true_m < quantile_m, quantile_m < range_m
    return {
        "short": float(below[short].mean()) if short.any() else float("nan"),
        "all": float(below.mean()),
        "rays": int(short.sum()),
    }


def unseen_objects(objects: np.ndarray, predicted_m: np.ndarray, true_m: np.ndarray) -> tuple[int, int]:
    """Return the number of near objects, and how many of them a single picture misses as a whole.

    An object counts if `LEAST_RAYS` or more rays of a picture meet it, the nearest within `NEAR_OBJECT_M`. It is unseen
    if the prediction along each of its rays is too long by more than `UNSEEN_BEYOND_M`.

    Args:
        objects: `(N, R)` int, number of the object that each ray meets, the same for all rays of a picture that meet
            it; negative if a ray meets none.
        predicted_m: `(N, R)`, predicted distances.
        true_m: `(N, R)`, true distances.

    Returns:
        Number of objects that count, and number of those that are unseen.
    """
    counted, unseen = 0, 0
    for numbers, predicted, true in zip(objects, predicted_m, true_m, strict=True):
        for number in np.unique(numbers[numbers >= 0]):
            rays = numbers == number
            if rays.sum() >= LEAST_RAYS and true[rays].min() < NEAR_OBJECT_M:
                counted += 1
                unseen += bool((predicted[rays] > true[rays] + UNSEEN_BEYOND_M).all())
    return counted, unseen


def depth_rays_m(
    depth_m: np.ndarray, rays: int, field_of_view_rad: float, camera_height_m: float, range_m: float, sight_m: float
) -> np.ndarray:
    """Return distances along rays from a depth image of a level camera, without knowledge of the scene.

    A pixel counts if its point is above the ground and below `sight_m`; a ray ends at the nearest such point of its
    pixel columns.

    Args:
        depth_m: `(..., px, px)` along the camera's axis; infinite or beyond the range where there is no surface.
        rays: number of groups of pixel columns.
        field_of_view_rad: field of view of the square image.
        camera_height_m: height of the camera above the ground.
        range_m: horizontal distance beyond which a ray is free.
        sight_m: height above which nothing obstructs the car.

    Returns:
        `(..., rays)` horizontal distances in metres, at most `range_m`.
    """
    px = depth_m.shape[-1]
    slope = np.tan(field_of_view_rad / 2) * (1 - 2 * (np.arange(px) + 0.5) / px)  # rows up, columns left
    depth_m = np.where(np.isfinite(depth_m), depth_m, 1e3)
    height = camera_height_m + depth_m * slope[:, None]
    # the ground at the far end of a pixel seems higher than zero, by at most one pixel's extent
    ground = 0.02 + depth_m * 2 * np.tan(field_of_view_rad / 2) / px
    counts = (height > ground) & (height < sight_m)
    distance = np.where(counts, depth_m * np.sqrt(1 + slope**2), range_m)
    columns = distance.min(-2)
    edges = np.arange(rays) * px // rays
    return np.minimum(np.minimum.reduceat(columns, edges, axis=-1), range_m).astype(np.float32)
