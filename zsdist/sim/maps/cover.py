"""Occupied space of a map as few boxes and discs, each within a tolerance of it.

A greedy cover: of each connected part the disc or turned box is taken that covers most of what is not yet covered and
least of what is free. Its position and size are then refined until they agree best with the picture. This goes on until
no occupied sample is farther than the tolerance from a shape.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from zsdist.errors import SceneError
from zsdist.sim.maps import kernels

MAX_SIDE_M = 39.0
MAX_RADIUS_M = 9.5
_SAMPLE_M = 0.025  # cells are divided until their parts are no larger
_ANGLES = 4  # directions of walls that are tried in each part, besides the picture's own
_PEAKS = 12  # discs that are tried at a time
_BRIDGED = 0.5  # share of the tolerance by which a shape may first reach into free space
_STEPS = (8.0, 2.0, 1.0, 0.5, 0.25)  # of the refinement, in samples
_TURNS_RAD = (0.02, 0.01, 0.005, 0.0025, 0.00125)
_FORBIDDEN = 50.0  # weight of free samples beyond the tolerance, against 1 of occupied ones
_ROUNDS = 25  # most rounds with one step
_ROUND_SHARE = 0.94  # least share of its enclosing circle that a part has that is tried as one disc


@dataclass(frozen=True)
class Disc:
    """Disc: centre and radius in metres, from the lower left corner of the picture along its rows and columns."""

    x_m: float
    y_m: float
    radius_m: float


@dataclass(frozen=True)
class Slab:
    """Turned box: centre, length, width in metres and angle in radians, in the frame of `Disc`."""

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    angle_rad: float


Shape = list[float]  # `[x, y, radius]`, or `[x, y, half length, half width, angle]`, in samples


def cover(occupied: np.ndarray, cell_m: float, tolerance_m: float, most: int) -> list[Disc | Slab]:
    """Return shapes that cover occupied cells.

    Every occupied point is within the tolerance of a shape. Shapes reach about as far into free space at most.

    Args:
        occupied: `[row, column]` bool.
        cell_m: side of a cell.
        tolerance_m: greatest distance.
        most: greatest number of shapes.

    Raises:
        SceneError: more than `most` shapes would be needed.
    """
    parts = max(math.ceil(cell_m / _SAMPLE_M - 1e-9), 1)
    sample_m = cell_m / parts
    fine = np.kron(occupied, np.ones((parts, parts), np.uint8)) if parts > 1 else occupied.astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(fine, connectivity=4)
    margin = math.ceil(tolerance_m / sample_m) + 3
    shapes: list[Disc | Slab] = []
    for index in range(1, count):
        left, top, width, height = (int(value) for value in boxes[index, :4])
        part = np.zeros((height + 2 * margin, width + 2 * margin), np.uint8)
        part[margin:-margin, margin:-margin] = labels[top : top + height, left : left + width] == index
        limits = (MAX_SIDE_M / 2 / sample_m, MAX_RADIUS_M / sample_m)
        found = _Part(part, tolerance_m / sample_m, limits).cover(most - len(shapes))
        if found is None:
            raise SceneError(f"its obstacles need more than {most} boxes and rocks")
        for shape in found:
            x_m, y_m = (left - margin + shape[0]) * sample_m, (top - margin + shape[1]) * sample_m
            if len(shape) == 3:
                shapes.append(Disc(x_m, y_m, shape[2] * sample_m))
            else:
                shapes.append(Slab(x_m, y_m, 2 * shape[2] * sample_m, 2 * shape[3] * sample_m, shape[4]))
    return shapes


class _Part:
    """One connected part of the occupied space, with the shapes found so far.

    Args:
        occupied: `(rows, columns)` uint8 with a free border.
        tolerance: in samples.
        limits: greatest half side and radius, in samples.
    """

    def __init__(self, occupied: np.ndarray, tolerance: float, limits: tuple[float, float]) -> None:
        self._occupied = occupied
        self._tolerance = tolerance
        self._limits = limits
        self._marks = np.zeros(occupied.shape, np.int16)  # number of shapes over each sample
        self._shapes: list[Shape] = []
        self._away = cv2.distanceTransform(1 - occupied, cv2.DIST_L2, 5)  # distance of free samples from the part
        self._worth = np.where(occupied > 0, 1.0, np.where(self._away > tolerance, -_FORBIDDEN, -1.0))
        self._angles = [0.0, *_directions(occupied, tolerance)]

    def cover(self, most: int) -> list[Shape] | None:
        """Return the shapes; None if more than `most` would be needed."""
        for shape in self._as_one() if most > 0 else ():
            self._add(shape)
            self._refine(len(self._shapes) - 1)
            if not self._missing().any() and not self._protrudes():
                return self._shapes
            self._remove(len(self._shapes) - 1)
        missing = self._missing()
        while missing.any():
            if len(self._shapes) >= most:
                return None
            before = missing.sum()
            self._add(self._best(missing))
            self._refine(len(self._shapes) - 1)
            missing = self._missing()
            if missing.sum() >= before:  # the refined shape lost what it was found for
                self._remove(len(self._shapes) - 1)
                self._add(_one_sample(missing, self._tolerance))
                missing = self._missing()
        for index in reversed(range(len(self._shapes))):
            if len(self._shapes) > 1:
                self._refine(index)
        return [shape for shape in self._shapes if min(shape[2:4] if len(shape) == 5 else shape[2:]) > 0.1]

    def _as_one(self) -> Iterator[Shape]:
        """Yield the whole part as one disc, if it is round, and as one box."""
        points = np.argwhere(self._occupied)[:, ::-1].astype(np.float32)
        (x, y), radius = cv2.minEnclosingCircle(points)
        if len(points) >= _ROUND_SHARE * math.pi * radius**2 - 4 and radius <= self._limits[1]:
            x, y = (float(v) + 0.5 for v in points.mean(0))
            yield [x, y, math.sqrt(len(points) / math.pi)]
        (x, y), (width, height), angle = cv2.minAreaRect(points)
        sides = (width + 1, height + 1)
        if len(points) >= 0.8 * sides[0] * sides[1] and max(sides) <= 2 * self._limits[0]:
            yield _lengthwise([x + 0.5, y + 0.5, sides[0] / 2, sides[1] / 2, math.radians(angle)])

    def _best(self, missing: np.ndarray) -> Shape:
        """Return the disc or box with the best balance of covered and free samples, near one missing part."""
        rows, columns = self._window(missing)
        marks = self._marks[rows, columns]
        weights = np.where(marks > 0, 0.0, self._worth[rows, columns])
        allowed = (self._away[rows, columns] <= max(_BRIDGED * self._tolerance, 0.5)).astype(np.uint8)
        best, found = 0.0, None
        for shape, total in (*self._discs(allowed, weights), *self._slabs(allowed, weights)):
            if total > best:
                best, found = total, shape
        if found is None:
            return _one_sample(missing, self._tolerance)
        return [found[0] + columns.start, found[1] + rows.start, *found[2:]]

    def _window(self, missing: np.ndarray) -> tuple[slice, slice]:
        """Return rows and columns around the largest missing part."""
        _, _, stats, _ = cv2.connectedComponentsWithStats(missing.astype(np.uint8), connectivity=8)
        left, top, width, height = stats[1:][stats[1:, 4].argmax(), :4]
        around = max(
            math.ceil(3 * self._tolerance) + 2, int(1.2 * max(width, height))
        )  # a wall may go on behind others
        return (
            slice(max(top - around, 0), min(top + height + around, missing.shape[0])),
            slice(max(left - around, 0), min(left + width + around, missing.shape[1])),
        )

    def _discs(self, allowed: np.ndarray, weights: np.ndarray) -> Iterator[tuple[Shape, float]]:
        depth = cv2.distanceTransform(np.pad(allowed, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
        depth = np.where(weights > 0, depth, 0.0)  # one that is covered needs no disc
        for _ in range(_PEAKS):
            row, column = np.unravel_index(depth.argmax(), depth.shape)
            radius = float(min(depth[row, column] - 0.5, self._limits[1]))
            if radius < 0.5:
                return
            x, y = float(column) + 0.5, float(row) + 0.5
            yield [x, y, radius], kernels.sum_in_disc(weights, x, y, radius)
            cv2.circle(depth, (int(column), int(row)), max(int(0.7 * radius), 1), 0.0, -1)

    def _slabs(self, allowed: np.ndarray, weights: np.ndarray) -> Iterator[tuple[Shape, float]]:
        rows, columns = allowed.shape
        for angle in self._angles:
            turn, size = _turned(rows, columns, angle)
            upright = allowed if not angle else cv2.warpAffine(allowed, turn, size, flags=cv2.INTER_NEAREST)
            gains = (
                weights if not angle else cv2.warpAffine(weights, turn, size, flags=cv2.INTER_NEAREST, borderValue=-1.0)
            )
            totals = np.pad(np.cumsum(np.cumsum(gains, 0), 1), ((1, 0), (1, 0)))
            total, top, bottom, left, right = kernels.best_rectangle(upright > 0, totals)
            if total <= 0:
                continue
            limit = int(2 * self._limits[0])
            right, bottom = min(right, left + limit), min(bottom, top + limit)
            middle = np.array([(left + right) / 2 - 0.5, (top + bottom) / 2 - 0.5, 1.0])
            x, y = cv2.invertAffineTransform(turn) @ middle + 0.5
            shape = _lengthwise([float(x), float(y), (right - left) / 2, (bottom - top) / 2, angle])
            yield shape, total

    def _refine(self, index: int) -> None:
        """Move and resize one shape until the picture is covered best, given the other shapes."""
        shape = self._shapes[index]
        self._mark(shape, -1)
        weights = np.where(self._marks > 0, 0.0, self._worth)
        value = _sum(weights, shape)
        for step, turn in zip(_STEPS, _TURNS_RAD, strict=True):
            for _ in range(_ROUNDS):
                before = value
                for change in _changes(shape, step, turn):
                    moved = [one + other for one, other in zip(shape, change, strict=True)]
                    small = min(moved[2:4] if len(moved) == 5 else moved[2:]) < 0.25
                    large = moved[2] > self._limits[1 if len(moved) == 3 else 0]
                    total = -math.inf if small or large else _sum(weights, moved)
                    if total > value + 1e-6:
                        shape, value = moved, total
                if value <= before:
                    break
        self._shapes[index] = shape
        self._mark(shape, 1)

    def _missing(self) -> np.ndarray:
        """Return the occupied samples that are farther than the tolerance from every shape."""
        if not self._shapes:
            return self._occupied > 0
        away = cv2.distanceTransform((self._marks == 0).astype(np.uint8), cv2.DIST_L2, 5)
        return (self._occupied > 0) & (away > self._tolerance)

    def _protrudes(self) -> bool:
        """Return whether the shapes reach farther than the tolerance into free space."""
        return bool(self._away[self._marks > 0].max(initial=0.0) > self._tolerance)

    def _add(self, shape: Shape) -> None:
        self._shapes.append(shape)
        self._mark(shape, 1)

    def _remove(self, index: int) -> None:
        self._mark(self._shapes.pop(index), -1)

    def _mark(self, shape: Shape, step: int) -> None:
        if len(shape) == 3:
            x, y, radius = shape
            kernels.mark_disc(self._marks, x, y, radius, step)
        else:
            x, y, half_l, half_w, angle = shape
            kernels.mark_box(self._marks, x, y, half_l, half_w, angle, step)


def _directions(occupied: np.ndarray, tolerance: float) -> list[float]:
    """Return the most common directions of a part's outline, in radians from 0 to a quarter of a turn."""
    lengths = np.zeros(90)
    contours, _ = cv2.findContours(occupied, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    for contour in contours:
        corners = cv2.approxPolyDP(contour, max(0.6 * tolerance, 1.2), True)[:, 0].astype(float)
        for dx, dy in np.roll(corners, -1, 0) - corners:
            lengths[int(math.degrees(math.atan2(dy, dx)) % 90.0 + 0.5) % 90] += math.hypot(dx, dy)
    smooth = lengths + (np.roll(lengths, -1) + np.roll(lengths, 1)) / 2
    found: list[float] = []
    for _ in range(_ANGLES):
        peak = int(np.argmax(smooth))
        if smooth[peak] < 0.05 * lengths.sum():
            break
        found.append(math.radians(peak))
        smooth[np.arange(peak - 4, peak + 5) % 90] = 0.0
    return [angle for angle in found if angle]


def _turned(rows: int, columns: int, angle: float) -> tuple[np.ndarray, tuple[int, int]]:
    """Return the transform that makes a direction upright, and the size of the turned picture."""
    cos, sin = math.cos(angle), math.sin(angle)
    width, height = math.ceil(columns * cos + rows * sin) + 2, math.ceil(columns * sin + rows * cos) + 2
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0]])
    turn[:, 2] = np.array([width / 2, height / 2]) - turn[:, :2] @ (columns / 2, rows / 2)
    return turn, (width, height)


def _changes(shape: Shape, step: float, turn: float) -> Iterator[Shape]:
    """Yield the changes of a shape that a step of the refinement tries; a box may move one side alone."""
    signs = (step, -step)
    if len(shape) == 3:
        for index in range(3):
            for value in signs:
                yield [value if i == index else 0.0 for i in range(3)]
        return
    cos, sin = math.cos(shape[4]), math.sin(shape[4])
    for value in signs:
        for side in (0.5, -0.5):
            yield [side * value * cos, side * value * sin, value / 2, 0.0, 0.0]
            yield [-side * value * sin, side * value * cos, 0.0, value / 2, 0.0]
        yield [value * cos, value * sin, 0.0, 0.0, 0.0]
        yield [-value * sin, value * cos, 0.0, 0.0, 0.0]
    for value in (turn, -turn):
        yield [0.0, 0.0, 0.0, 0.0, value]


def _sum(weights: np.ndarray, shape: Shape) -> float:
    return kernels.sum_in_disc(weights, *shape) if len(shape) == 3 else kernels.sum_in_box(weights, *shape)


def _lengthwise(shape: Shape) -> Shape:
    """Return a box with its longer side along its angle."""
    x, y, half_l, half_w, angle = shape
    return [x, y, half_l, half_w, angle] if half_l >= half_w else [x, y, half_w, half_l, angle + math.pi / 2]


def _one_sample(missing: np.ndarray, tolerance: float) -> Shape:
    """Return a small square on the first missing sample."""
    row, column = np.argwhere(missing)[0]
    return [float(column) + 0.5, float(row) + 0.5, 0.5, 0.5, 0.0]
