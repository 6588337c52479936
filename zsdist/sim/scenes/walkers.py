"""People who walk back and forth along their paths and stop for the car."""

import math
from bisect import bisect_right
from itertools import accumulate, pairwise

import numpy as np

from zsdist.sim.physics.collision import NO_BOXES, clearance_m
from zsdist.sim.scenes.scene import Obstacle
from zsdist.types import Pose

STOP_M = 1.5  # a person stands still while its surface is within this distance of the car's box


class Walker:
    """One walking person.

    Args:
        obstacle: person with a path.

    Attributes:
        x_m: x of the present position.
        y_m: y of the present position.
    """

    def __init__(self, obstacle: Obstacle) -> None:
        self._points = obstacle.path
        self._distances_m = [0.0, *accumulate(math.dist(*leg) for leg in pairwise(self._points))]  # to each point
        self._speed_mps = obstacle.speed_mps
        self._radius_m = obstacle.radius_m
        self._walked_m = 0.0
        self.x_m, self.y_m = self._points[0]

    def walk(self, car: Pose, duration_s: float) -> bool:
        """Walk for `duration_s` unless the car is near; return whether the person moved."""
        circle = np.array([(self.x_m, self.y_m, self._radius_m)])
        if clearance_m(car, circle, NO_BOXES) < STOP_M:
            return False
        self._walked_m += self._speed_mps * duration_s
        length_m = self._distances_m[-1]
        along_m = self._walked_m % (2 * length_m)
        along_m = min(along_m, 2 * length_m - along_m)  # on the second half it walks back
        leg = min(bisect_right(self._distances_m, along_m), len(self._points) - 1)
        (x_m, y_m), (next_x_m, next_y_m) = self._points[leg - 1 : leg + 1]
        share = (along_m - self._distances_m[leg - 1]) / (self._distances_m[leg] - self._distances_m[leg - 1])
        self.x_m, self.y_m = x_m + share * (next_x_m - x_m), y_m + share * (next_y_m - y_m)
        return True
