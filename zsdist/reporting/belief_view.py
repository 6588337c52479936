"""The car's belief map, drawn as one panel of a film."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from zsdist.evaluation.drivers import Thought
from zsdist.planning.footprint import CAR_LENGTH_M, CAR_WIDTH_M
from zsdist.planning.grid import Grid
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

UNSEEN, FREE, OCCUPIED = (205, 209, 214), (255, 255, 255), (58, 64, 74)
BLOCKS, TARGET, TRUTH = (150, 156, 163), (86, 180, 233), (160, 90, 60)
PATH, CAR, START, GOAL, SUBGOAL = (0, 114, 178), (26, 107, 184), (31, 166, 74), (224, 32, 32), (230, 159, 0)
EDGE = (255, 255, 255)
_SHIFT = 4  # OpenCV draws to a sixteenth of a pixel


class BeliefView:
    """Drawing of the belief map of one drive from above, with north at the top.

    Args:
        scene: scene that is driven; its true obstacles are outlined, although the car does not know them.
        grid: planning grid of the map.
        size_px: side of the panel.
    """

    def __init__(self, scene: Scene, grid: Grid, size_px: int) -> None:
        self._scene, self._grid, self._px = scene, grid, size_px
        self._scale = size_px / grid.arena_m

    def draw(
        self, thought: Thought | None, pose: Pose, path: Sequence[tuple[float, float]], people: np.ndarray | None
    ) -> np.ndarray:
        """Return the panel `(px, px, 3)` uint8.

        Args:
            thought: thought with the map to draw; None: the driver has no map, and all ground is drawn as unseen.
            pose: pose of the car.
            path: path driven so far, `(x, y)` in metres.
            people: `(W, 2)` metres, positions of the walking obstacles; None where nobody walks.
        """
        panel = self._ground(thought)
        self._draw_blocks(panel, thought)
        self._outline(panel, people)
        self._line(panel, [*path, pose[:2]], PATH, 2)
        start = self._scene.start.pose
        self._dot(panel, start[:2], 0.32, START)
        if thought is not None:
            self._ring(panel, thought.decision.subgoal, 0.42, SUBGOAL)
        self._star(panel, self._scene.goal, 0.75)
        self._draw_car(panel, pose)
        return panel

    def _ground(self, thought: Thought | None) -> np.ndarray:
        size = self._grid.fine_size
        cells = np.full((size, size, 3), UNSEEN, np.uint8)
        if thought is not None:
            cells[thought.situation.seen] = FREE
            cells[thought.situation.occupied] = OCCUPIED
        return cv2.resize(cells[::-1], (self._px, self._px), interpolation=cv2.INTER_NEAREST)

    def _draw_blocks(self, panel: np.ndarray, thought: Thought | None) -> None:
        half, side = self._grid.side_m / 2, self._grid.side_m / self._grid.blocks
        if thought is not None:
            bx, by = self._grid.block_of(*self._grid.cell_at(*thought.decision.subgoal))
            corners = [(bx * side - half, by * side - half), ((bx + 1) * side - half, (by + 1) * side - half)]
            (left, bottom), (right, top) = (self._pixel(corner) for corner in corners)
            part = panel[round(top) : round(bottom), round(left) : round(right)]
            part[:] = np.round(0.72 * part + 0.28 * np.array(TARGET)).astype(np.uint8)
        for index in range(self._grid.blocks + 1):
            at = index * side - half
            self._line(panel, [(at, -half), (at, half)], BLOCKS, 1)
            self._line(panel, [(-half, at), (half, at)], BLOCKS, 1)

    def _outline(self, panel: np.ndarray, people: np.ndarray | None) -> None:
        for x, y, radius in self._scene.circles(people):
            cv2.circle(panel, self._fixed((x, y)), self._length(radius), TRUTH, 1, cv2.LINE_AA, _SHIFT)
        for x, y, length, width, heading in self._scene.boxes():
            self._line(panel, _corners(Pose(x, y, heading), length, width), TRUTH, 1, closed=True)

    def _draw_car(self, panel: np.ndarray, pose: Pose) -> None:
        corners = _corners(pose, CAR_LENGTH_M, CAR_WIDTH_M)
        cv2.fillPoly(panel, [self._points(corners)], CAR, cv2.LINE_AA, _SHIFT)
        self._line(panel, corners, EDGE, 1, closed=True)
        front = _corners(pose, 0.5 * CAR_LENGTH_M, 0.6 * CAR_WIDTH_M)
        tip = (
            pose.x_m + 0.44 * CAR_LENGTH_M * math.cos(pose.heading_rad),
            pose.y_m + 0.44 * CAR_LENGTH_M * math.sin(pose.heading_rad),
        )
        cv2.fillPoly(panel, [self._points([tip, front[1], front[2]])], EDGE, cv2.LINE_AA, _SHIFT)

    def _star(self, panel: np.ndarray, point: tuple[float, float], radius_m: float) -> None:
        angles = [math.pi / 2 + index * math.pi / 5 for index in range(10)]
        radii = [radius_m if index % 2 == 0 else 0.42 * radius_m for index in range(10)]
        tips = [
            (point[0] + radius * math.cos(angle), point[1] + radius * math.sin(angle))
            for angle, radius in zip(angles, radii, strict=True)
        ]
        cv2.fillPoly(panel, [self._points(tips)], GOAL, cv2.LINE_AA, _SHIFT)
        self._line(panel, tips, EDGE, 1, closed=True)

    def _dot(self, panel: np.ndarray, point: tuple[float, float], radius_m: float, colour: tuple[int, ...]) -> None:
        cv2.circle(panel, self._fixed(point), self._length(radius_m), colour, -1, cv2.LINE_AA, _SHIFT)

    def _ring(self, panel: np.ndarray, point: tuple[float, float], radius_m: float, colour: tuple[int, ...]) -> None:
        cv2.circle(panel, self._fixed(point), self._length(radius_m), colour, 2, cv2.LINE_AA, _SHIFT)

    def _line(
        self,
        panel: np.ndarray,
        points: Sequence[tuple[float, float]],
        colour: tuple[int, ...],
        width_px: int,
        closed: bool = False,
    ) -> None:
        cv2.polylines(panel, [self._points(points)], closed, colour, width_px, cv2.LINE_AA, _SHIFT)

    def _points(self, points: Sequence[tuple[float, float]]) -> np.ndarray:
        return np.array([self._fixed(point) for point in points], np.int32)

    def _fixed(self, point: Sequence[float]) -> tuple[int, int]:
        """Return a point in metres as the fixed-point pixel coordinates that OpenCV takes."""
        x, y = self._pixel(point)
        return round(x * 2**_SHIFT), round(y * 2**_SHIFT)

    def _pixel(self, point: Sequence[float]) -> tuple[float, float]:
        half = self._grid.arena_m / 2
        return (float(point[0]) + half) * self._scale, (half - float(point[1])) * self._scale

    def _length(self, metres: float) -> int:
        return round(metres * self._scale * 2**_SHIFT)


def _corners(pose: Pose, length_m: float, width_m: float) -> list[tuple[float, float]]:
    """Return the corners of a box at a pose: rear left, front left, front right, rear right."""
    cosine, sine = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    sides = ((-1, 1), (1, 1), (1, -1), (-1, -1))
    return [
        (
            pose.x_m + cosine * ahead * length_m / 2 - sine * left * width_m / 2,
            pose.y_m + sine * ahead * length_m / 2 + cosine * left * width_m / 2,
        )
        for ahead, left in sides
    ]
