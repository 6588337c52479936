"""What one car believes of the ground: log-odds of occupied space on the fine frame, from rays with uncertainty.

Looks add up. A surface that one look misses is put there by the next, and one that was imagined is worn away by looks
through it, so no single reading decides.
"""

import math

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.footprint import CAR_LENGTH_M, CAR_WIDTH_M
from zsdist.planning.grid import Grid
from zsdist.types import Pose, View

HIT = 1.6  # log-odds a certain hit adds
PASS = 0.4  # log-odds a certain passage takes away; a hit of one look in five holds its ground
TINY = 1e-6  # keeps odds finite
CEILING = 2.4  # belief stays correctable: six certain passages undo whatever was believed
FLOOR = -0.6  # and half a certain hit: who walks onto ground that was free is believed at the first look
THICKNESS_M = 0.4  # what is behind a surface is occupied so far; deeper is unknown


class BeliefMap:
    """Occupied, free and unknown space of the arena, in the fine frame of a `Grid`, indexed `[iy, ix]`."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self._log_odds = np.zeros((grid.fine_size, grid.fine_size), np.float32)
        self._seen = np.zeros((grid.fine_size, grid.fine_size), np.bool_)

    def update(self, pose: Pose, view: View, camera_forward_m: float) -> None:
        """Takes in one look.

        Along a ray whose distance is distributed as the view says, a square at distance `d` is passed as surely as the
        ray survives beyond it (p), and hit as surely as the ray ends in it or up to `THICKNESS_M` before it (h); where
        it ended earlier, nothing is learned. The square's log-odds grow by log(h / p), within `-PASS` and `HIT`,
        times h + p, the share of the ray that tells of it. So a surface that is far away, of which little but the
        direction is sure, closes the squares in which it is likelier than not, and not all in which it may be.

        Args:
            pose: the car's centre; where it stands is free.
            view: rays as distributions over distance; of a view without rays nothing is learned.
            camera_forward_m: how far ahead of the centre the camera sits.
        """
        camera_x = pose.x_m + camera_forward_m * math.cos(pose.heading_rad)
        camera_y = pose.y_m + camera_forward_m * math.sin(pose.heading_rad)
        half_m = self.grid.arena_m / 2
        _look(
            self._log_odds,
            self._seen,
            camera_x + half_m,
            camera_y + half_m,
            pose.heading_rad,
            view.ray_probabilities,
            view.ray_angles_rad,
            view.bin_edges_m,
            self.grid.fine_m,
        )
        self.clear_car(pose)

    def clear_car(self, pose: Pose) -> None:
        """The ground under the car is free: it stands there."""
        half_m = self.grid.arena_m / 2
        place = (pose.x_m + half_m, pose.y_m + half_m, pose.heading_rad)
        _clear_box(self._log_odds, self._seen, *place, CAR_LENGTH_M / 2, CAR_WIDTH_M / 2, self.grid.fine_m)

    def clear_disc(self, x_m: float, y_m: float, radius_m: float) -> None:
        """A disc that is known to be free, such as the one about the start."""
        xs, ys = self.grid.fine_centres()
        inside = (xs[None, :] - x_m) ** 2 + (ys[:, None] - y_m) ** 2 <= radius_m**2
        self._log_odds[inside] = FLOOR
        self._seen |= inside

    def occupied(self, above: float = 0.0) -> np.ndarray:
        """Squares believed occupied, `(fine_size, fine_size)` bool; what was never seen is not.

        Args:
            above: log-odds; more than the working threshold of 0 leaves out what is doubtful.
        """
        return self._log_odds > above

    def seen(self) -> np.ndarray:
        """Squares that some look has told of, `(fine_size, fine_size)` bool."""
        return self._seen.copy()


@compiled()
def _below(values: np.ndarray, limit: float) -> int:
    """How many values are below a limit: where it belongs among ascending ones, without branches as a bisection has."""
    count = 0
    for index in range(len(values)):
        count += 1 if values[index] < limit else 0
    return count


@compiled()
def _bin(edges: np.ndarray, distance: float) -> tuple[int, float]:
    """The bin in which a distance lies, by its upper edge, and which share of it lies below; mass is spread evenly."""
    last = len(edges) - 1
    if distance <= edges[0]:
        return 1, 0.0
    if distance >= edges[last]:
        return last, 1.0
    upper = _below(edges, distance)
    return upper, (distance - edges[upper - 1]) / (edges[upper] - edges[upper - 1])


@compiled()
def _look(log_odds, seen, camera_x, camera_y, heading, probabilities, ray_angles, bin_edges, square):  # noqa: ANN001, ANN202
    if len(ray_angles) == 0:
        return
    angles, edges = ray_angles.astype(np.float64), bin_edges.astype(np.float64)
    ends = np.zeros((len(angles), len(edges)))  # how surely each ray has ended by each edge
    for ray in range(len(angles)):
        for upper in range(1, len(edges)):
            ends[ray, upper] = ends[ray, upper - 1] + probabilities[ray, upper - 1]
    size = log_odds.shape[0]
    reach, half, rays = edges[-1], square / 2, len(angles)
    descending = -angles
    field = angles[0] + 0.5 * (angles[0] - angles[1])  # outer edge of the outermost ray
    far_off = 1.000001 * reach * reach
    aside = 1.000001 * math.tan(field) if field < 1.5 else np.inf
    cosine, sine = math.cos(heading), math.sin(heading)
    low_x, high_x = max(int((camera_x - reach) / square), 0), min(int((camera_x + reach) / square) + 1, size)
    low_y, high_y = max(int((camera_y - reach) / square), 0), min(int((camera_y + reach) / square) + 1, size)
    for iy in range(low_y, high_y):
        north = (iy + 0.5) * square - camera_y
        for ix in range(low_x, high_x):
            east = (ix + 0.5) * square - camera_x
            ahead, left = cosine * east + sine * north, cosine * north - sine * east
            if ahead <= 0.0 or ahead * ahead + left * left > far_off or abs(left) > aside * ahead:
                continue  # most of them, told without the functions below
            distance = math.hypot(ahead, left)
            if distance > reach or distance < half:
                continue
            angle = math.atan2(left, ahead)
            if abs(angle) > field:
                continue
            spread = half / distance  # near squares are wider than a ray: the most alarming ray counts
            first = min(_below(descending, -(angle + spread)), rays - 1)
            last = max(_below(descending, -(angle - spread)) - 1, 0)
            if last < first:  # between two rays: the nearer one
                first, last = last, first
                if angles[first] - angle < angle - angles[last]:
                    last = first
                else:
                    first = last
            change, told = -PASS, 0.0
            far, far_share = _bin(edges, distance + half)
            near, near_share = _bin(edges, distance - THICKNESS_M)
            for ray in range(first, last + 1):
                end = ends[ray]
                beyond = end[far - 1] + far_share * (end[far] - end[far - 1])  # that it ended before or in the square
                before = end[near - 1] + near_share * (end[near] - end[near - 1])
                odds = math.log(max(beyond - before, TINY) / max(1.0 - beyond, TINY))
                change = max(change, (1.0 - before) * min(max(odds, -PASS), HIT))
                told = max(told, 1.0 - before)
            log_odds[iy, ix] = min(max(log_odds[iy, ix] + change, FLOOR), CEILING)
            if told > 0.5:
                seen[iy, ix] = True


@compiled()
def _clear_box(log_odds, seen, x, y, heading, half_length, half_width, square):  # noqa: ANN001, ANN202
    size = log_odds.shape[0]
    cosine, sine, reach = math.cos(heading), math.sin(heading), math.hypot(half_length, half_width)
    for iy in range(max(int((y - reach) / square), 0), min(int((y + reach) / square) + 1, size)):
        for ix in range(max(int((x - reach) / square), 0), min(int((x + reach) / square) + 1, size)):
            east, north = (ix + 0.5) * square - x, (iy + 0.5) * square - y
            if abs(cosine * east + sine * north) <= half_length and abs(cosine * north - sine * east) <= half_width:
                log_odds[iy, ix] = FLOOR
                seen[iy, ix] = True
