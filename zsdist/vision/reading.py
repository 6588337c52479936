"""Reading of a picture by the vision model, and the view that follows from it for a goal; numpy alone."""

from typing import NamedTuple

import numpy as np

from zsdist.types import View
from zsdist.vision.labels import expected_openness, progress, reward_label
from zsdist.vision.rays import BIN_CENTRES_M, BIN_EDGES_M, RAYS, quantile_m, ray_angles_rad

READING_OUTPUTS = ["clearance", "dynamic", "rays"]


class Reading(NamedTuple):
    """Outputs of the model for B images; they do not depend on the goal.

    Attributes:
        clearance: `(B, 3, K)` distributions of the distance to the nearest obstacle forward, left and right.
        dynamic: `(B, 3)` probabilities that the kind of this obstacle moves.
        rays: `(B, R, K)` distributions of the distance along each ray.
    """

    clearance: np.ndarray
    dynamic: np.ndarray
    rays: np.ndarray


class Views:
    """Maker of views from readings.

    Args:
        quantile: share of a distribution of the clearance at which its quantile stands for it.
        field_of_view_rad: field of view of the camera.
    """

    def __init__(self, quantile: float, field_of_view_rad: float) -> None:
        self._quantile = quantile
        self._angles = ray_angles_rad(RAYS, field_of_view_rad)

    def of(self, reading: Reading, goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> list[View]:
        """Return the view of each image of a reading, with the advice R_p for the given goals.

        Args:
            reading: outputs of the model for B images.
            goal_bearing_rad: `(B,)` direction of the goal from the car's heading, left positive.
            goal_distance_m: `(B,)`, distance to the goal.

        Raises:
            ValueError: the number of goals is not that of images.
        """
        clearance, dynamic, rays = reading
        bearing, distance = np.asarray(goal_bearing_rad, np.float32), np.asarray(goal_distance_m, np.float32)
        if bearing.shape != (len(rays),) or distance.shape != (len(rays),):
            raise ValueError(
                f"goal bearings are {bearing.shape} and distances {distance.shape}; allowed is ({len(rays)},), "
                "one for each image"
            )
        advice = reward_label(
            expected_openness(clearance, BIN_CENTRES_M, dynamic, distance), progress(bearing, distance)
        ).astype(np.float32)
        clearance_m = quantile_m(clearance, self._quantile)
        return [
            View(advice[i], clearance_m[i], dynamic[i], rays[i], self._angles, BIN_EDGES_M) for i in range(len(rays))
        ]
