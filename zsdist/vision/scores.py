"""How good a reading of images is: by the action it would choose, and by the rays it would put on the map."""

import numpy as np

MISS_M = (1.5, 2.5)  # a miss: nearer than the first in truth, said to be beyond the second
FALSE_ALARM_M = (3.5, 2.0)  # a false alarm: beyond the first in truth, said to be nearer than the second


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
