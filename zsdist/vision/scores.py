"""How good a reading of images is: by the action it would choose, and by the rays it would put on the map."""

import numpy as np

MISS_M = (1.5, 2.5)  # a miss: nearer than the first in truth, said to be beyond the second
FALSE_ALARM_M = (3.5, 2.0)  # a false alarm: beyond the first in truth, said to be nearer than the second
NEAR_OBJECT_M = 2.5  # an object whose nearest point in view is nearer counts
UNSEEN_BEYOND_M = 1.0  # an object is unseen where each of its rays is said to be farther by more
LEAST_RAYS = 2  # an object that fewer rays meet is too narrow, or too little of it is in view, to count


def action_scores(predicted: np.ndarray, labels: np.ndarray) -> dict[str, float]:
    """Compares rewards `(N, 3)` that a model says with the true labels `(N, 3)`.

    Returns:
        `best_action_accuracy`: share of images on which the action that looks best is one that is best (where several
        are, to 0.001, each is right); `regret`: mean loss of true label by following what looks best; `mae`: mean
        absolute error of the rewards.
    """
    best = labels.max(1)
    gained = np.take_along_axis(labels, predicted.argmax(1)[:, None], 1)[:, 0]
    return {
        "best_action_accuracy": float(np.mean(gained >= best - 1e-3)),
        "regret": float(np.mean(best - gained)),
        "mae": float(np.abs(predicted - labels).mean()),
    }


def ray_scores(said_m: np.ndarray, true_m: np.ndarray) -> dict[str, float]:
    """Misses and false alarms of distances `(N, R)` along rays, as shares of the rays where each could happen."""
    near, far = true_m < MISS_M[0], true_m > FALSE_ALARM_M[0]
    return {
        "miss_rate": float(np.sum(near & (said_m > MISS_M[1])) / max(near.sum(), 1)),
        "false_alarm_rate": float(np.sum(far & (said_m < FALSE_ALARM_M[1])) / max(far.sum(), 1)),
    }


def calibration(quantile_m: np.ndarray, true_m: np.ndarray, range_m: float) -> dict[str, float]:
    """How often the truth lies under a quantile; of a calibrated reading as often as the quantile's share.

    Args:
        quantile_m: `(N, R)` a quantile of the distances said, at most `range_m`.
        true_m: `(N, R)`, capped at `range_m`.
        range_m: of the camera.

    Returns:
        `short`: the share over rays whose quantile is short of the range, NaN where none is; `all`: over all rays, of
        which those that are free for certain can never have the truth below; `rays`: how many are short of it.
    """
    below, short = true_m < quantile_m, quantile_m < range_m
    return {
        "short": float(below[short].mean()) if short.any() else float("nan"),
        "all": float(below.mean()),
        "rays": int(short.sum()),
    }


def unseen_objects(objects: np.ndarray, said_m: np.ndarray, true_m: np.ndarray) -> tuple[int, int]:
    """Whole objects that one look does not see.

    An object counts where `LEAST_RAYS` or more rays of a picture meet it, the nearest of them within `NEAR_OBJECT_M`.
    It is unseen where every one of its rays is said to be more than `UNSEEN_BEYOND_M` longer than it is.

    Args:
        objects: `(N, R)` int, a number of what each ray meets, the same for rays that meet the same object of a
            picture; negative where that is none.
        said_m: `(N, R)` distances said.
        true_m: `(N, R)`.

    Returns:
        How many objects count, and how many of those are unseen.
    """
    counted, unseen = 0, 0
    for numbers, said, true in zip(objects, said_m, true_m, strict=True):
        for number in np.unique(numbers[numbers >= 0]):
            rays = numbers == number
            if rays.sum() >= LEAST_RAYS and true[rays].min() < NEAR_OBJECT_M:
                counted += 1
                unseen += bool((said[rays] > true[rays] + UNSEEN_BEYOND_M).all())
    return counted, unseen


def depth_rays_m(
    depth_m: np.ndarray, rays: int, field_of_view_rad: float, camera_height_m: float, range_m: float, sight_m: float
) -> np.ndarray:
    """Distances along rays that a depth image tells, with no knowledge of what is in the picture.

    A pixel counts where its point stands above the ground and below `sight_m`; a ray is the nearest such point of its
    pixel columns. For a level camera.

    Args:
        depth_m: `(..., px, px)` along the camera's axis; infinite or beyond the range where nothing is.
        rays: columns to gather the pixels in.
        field_of_view_rad: of the square image.
        camera_height_m: above the ground.
        range_m: horizontal distance beyond which a ray is free.
        sight_m: height above which nothing is in the car's way.

    Returns:
        `(..., rays)` horizontal distances in metres, at most `range_m`.
    """
    px = depth_m.shape[-1]
    slope = np.tan(field_of_view_rad / 2) * (1 - 2 * (np.arange(px) + 0.5) / px)  # of rows up, of columns left
    depth_m = np.where(np.isfinite(depth_m), depth_m, 1e3)
    height = camera_height_m + depth_m * slope[:, None]
    # the ground itself, at the far end of a pixel that looks on it, is no more than a pixel's worth above zero
    ground = 0.02 + depth_m * 2 * np.tan(field_of_view_rad / 2) / px
    counts = (height > ground) & (height < sight_m)
    distance = np.where(counts, depth_m * np.sqrt(1 + slope**2), range_m)
    columns = distance.min(-2)
    edges = np.arange(rays) * px // rays
    return np.minimum(np.minimum.reduceat(columns, edges, axis=-1), range_m).astype(np.float32)
