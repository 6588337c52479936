"""Belief map of one car: log-odds of occupancy on the fine grid, from rays with uncertainty.

The evidence of all views is summed. A surface that one view misses is added by the next. A surface that does not exist
is removed by later views through it. So no single view decides.
"""

import math

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.footprint import CAR_LENGTH_M, CAR_WIDTH_M
from zsdist.planning.grid import Grid
from zsdist.types import Pose, View

HIT = 1.6  # log-odds that a certain hit adds
PASS = 0.4  # log-odds that a certain passage subtracts; a surface stays if one view in five hits it
TINY = 1e-6  # keeps odds finite
CEILING = 2.4  # keeps belief correctable: six certain passages undo any belief
FLOOR = -0.6  # half a certain hit: a person who walks onto free ground is believed at the first view
THICKNESS_M = 0.4  # assumed thickness of a surface; space farther behind it stays unknown


class BeliefMap:
    """Occupied, free and unknown space of the arena, on the fine grid of a `Grid`, indexed `[iy, ix]`."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self._log_odds = np.zeros((grid.fine_size, grid.fine_size), np.float32)
        self._seen = np.zeros((grid.fine_size, grid.fine_size), np.bool_)

    def update(self, pose: Pose, view: View, camera_forward_m: float) -> None:
        """Update the belief with one view.

        The view gives the distribution of each ray's length. For a fine cell at distance d, p is the probability that
        the ray continues beyond the cell, and h the probability that it ends in the cell or up to `THICKNESS_M` before
        it. A ray that ends earlier carries no information about the cell. The cell's log-odds change by log(h / p),
        clipped to `-PASS` and `HIT`, times h + p, the probability that the ray carries information about the cell.
        So a far surface at an uncertain distance occupies only the cells in which it probably lies, not every cell in
        which it may lie.

        Args:
            pose: pose of the car's centre; the ground under the car becomes free.
            view: rays as distributions over distance; a view without rays changes nothing else.
            camera_forward_m: distance of the camera ahead of the car's centre.
        """
        camera_x = pose.x_m + camera_forward_m * math.cos(pose.heading_rad)
        camera_y = pose.y_m + camera_forward_m * math.sin(pose.heading_rad)
        half_m = self.grid.arena_m / 2
        _update(
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
        """Mark the ground under the car as free."""
        x, y = pose.x_m + self.grid.arena_m / 2, pose.y_m + self.grid.arena_m / 2
        half_length, half_width = CAR_LENGTH_M / 2, CAR_WIDTH_M / 2
        _clear_box(self._log_odds, self._seen, x, y, pose.heading_rad, half_length, half_width, self.grid.fine_m)

    def clear_disc(self, x_m: float, y_m: float, radius_m: float) -> None:
        """Mark a disc as free, such as the one around the start, which is known to be free."""
        xs, ys = self.grid.fine_centres()
        inside = (xs[None, :] - x_m) ** 2 + (ys[:, None] - y_m) ** 2 <= radius_m**2
        self._log_odds[inside] = FLOOR
        self._seen |= inside

    def occupied(self, above: float = 0.0) -> np.ndarray:
        """Return the fine cells believed occupied, `(fine_size, fine_size)` bool; cells never seen are not occupied.

        Args:
            above: threshold of the log-odds; a value above the usual 0 leaves out doubtful cells.
        """
        return self._log_odds > above

    def seen(self) -> np.ndarray:
        """Return the fine cells observed by at least one view or marked as free, `(fine_size, fine_size)` bool."""
        return self._seen.copy()


@compiled()
def _below(values: np.ndarray, limit: float) -> int:
    """Return the number of ascending values below a limit. A count needs none of the branches of a bisection."""
    count = 0
    for index in range(len(values)):
        count += 1 if values[index] < limit else 0
    return count


@compiled()
def _bin(edges: np.ndarray, distance: float) -> tuple[int, float]:
    """Return the index of the upper edge of a distance's bin, and the share of the bin that lies below the distance.

    The share is also the share of the bin's probability, which is spread evenly over the bin.
    """
    last = len(edges) - 1
    if distance <= edges[0]:
        return 1, 0.0
    if distance >= edges[last]:
        return last, 1.0
    upper = _below(edges, distance)
    return upper, (distance - edges[upper - 1]) / (edges[upper] - edges[upper - 1])


@compiled()
def _update(
    log_odds: np.ndarray,
    seen: np.ndarray,
    camera_x: float,
    camera_y: float,
    heading: float,
    probabilities: np.ndarray,
    ray_angles: np.ndarray,
    bin_edges: np.ndarray,
    fine_m: float,
) -> None:
    """Update `log_odds` and `seen` with one view; see `BeliefMap.update`. Coordinates begin at the arena's corner."""
    if len(ray_angles) == 0:
        return
    angles, edges = ray_angles.astype(np.float64), bin_edges.astype(np.float64)
    ends = np.zeros((len(angles), len(edges)))  # probability that each ray has ended at each edge
    for ray in range(len(angles)):
        for upper in range(1, len(edges)):
            ends[ray, upper] = ends[ray, upper - 1] + probabilities[ray, upper - 1]
    size = log_odds.shape[0]
    reach, half, rays = edges[-1], fine_m / 2, len(angles)
    descending = -angles
    field = angles[0] + 0.5 * (angles[0] - angles[1])  # outer edge of the outermost ray
    far_off = 1.000001 * reach * reach
    aside = 1.000001 * math.tan(field) if field < 1.5 else np.inf
    cosine, sine = math.cos(heading), math.sin(heading)
    low_x, high_x = max(int((camera_x - reach) / fine_m), 0), min(int((camera_x + reach) / fine_m) + 1, size)
    low_y, high_y = max(int((camera_y - reach) / fine_m), 0), min(int((camera_y + reach) / fine_m) + 1, size)
    for iy in range(low_y, high_y):
        north = (iy + 0.5) * fine_m - camera_y
        for ix in range(low_x, high_x):
            east = (ix + 0.5) * fine_m - camera_x
            ahead, left = cosine * east + sine * north, cosine * north - sine * east
            if ahead <= 0.0 or ahead * ahead + left * left > far_off or abs(left) > aside * ahead:
                continue  # most cells, without the slow functions below
            distance = math.hypot(ahead, left)
            if distance > reach or distance < half:
                continue
            angle = math.atan2(left, ahead)
            if abs(angle) > field:
                continue
            spread = half / distance  # a near cell spans several rays: the one that raises the log-odds most counts
            first = min(_below(descending, -(angle + spread)), rays - 1)
            last = max(_below(descending, -(angle - spread)) - 1, 0)
            if last < first:  # between two rays: the nearer one
                first, last = last, first
                if angles[first] - angle < angle - angles[last]:
                    last = first
                else:
                    first = last
            change, learned = -PASS, 0.0
            far, far_share = _bin(edges, distance + half)
            near, near_share = _bin(edges, distance - THICKNESS_M)
            for ray in range(first, last + 1):
                end = ends[ray]
                # Probabilities that the ray ends in the cell or before it, and that it ends before the surface.
                beyond = end[far - 1] + far_share * (end[far] - end[far - 1])
                before = end[near - 1] + near_share * (end[near] - end[near - 1])
                odds = math.log(max(beyond - before, TINY) / max(1.0 - beyond, TINY))
                change = max(change, (1.0 - before) * min(max(odds, -PASS), HIT))
                learned = max(learned, 1.0 - before)
            log_odds[iy, ix] = min(max(log_odds[iy, ix] + change, FLOOR), CEILING)
            if learned > 0.5:
                seen[iy, ix] = True


@compiled()
def _clear_box(
    log_odds: np.ndarray,
    seen: np.ndarray,
    x: float,
    y: float,
    heading: float,
    half_length: float,
    half_width: float,
    fine_m: float,
) -> None:
    """Mark the fine cells whose centre lies in a box as seen and free. Coordinates begin at the arena's corner."""
    size = log_odds.shape[0]
    cosine, sine, reach = math.cos(heading), math.sin(heading), math.hypot(half_length, half_width)
    for iy in range(max(int((y - reach) / fine_m), 0), min(int((y + reach) / fine_m) + 1, size)):
        for ix in range(max(int((x - reach) / fine_m), 0), min(int((x + reach) / fine_m) + 1, size)):
            east, north = (ix + 0.5) * fine_m - x, (iy + 0.5) * fine_m - y
            if abs(cosine * east + sine * north) <= half_length and abs(cosine * north - sine * east) <= half_width:
                log_odds[iy, ix] = FLOOR
                seen[iy, ix] = True
