"""Primitive shapes of a scene for both back ends: upright frustums, ellipsoids and boxes, turned about z only."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from zsdist.sim.scenes.kinds import CROWN_SHARE, KINDS, SEGMENT_WALL, TOP_SHARE, TRUNK_HEIGHT_M, WALL_HEIGHT_M
from zsdist.sim.scenes.scene import Obstacle, Scene

ARENA_HALF_M = 12.5
WALL_THICKNESS_M = 0.3
CAR_BODY_SHARE = 0.58  # height of a car's body, below the cabin, as a share of its height
_NECK_SHARE = 0.8  # height of a person's neck as a share of its height: above it is the head


Row = tuple[float, float, float, float, float, float, float]  # a row of `Primitives.rows`


class Form(IntEnum):
    """Shape of a row of `Primitives.rows`, with the meaning of its columns 3 to 5."""

    FRUSTUM = 0  # height, radius at the bottom, radius at the top
    ELLIPSOID = 1  # semi-axes in x, y, z; column 2 is the z of its centre
    BOX = 2  # height, half length, half width


class Part(IntEnum):
    """Part of an obstacle that a primitive forms; each part has a colour of its own in `Appearance`."""

    BODY = 0
    TOP = 1  # a tree's crown, a car's cabin, a person's head
    LEGS = 2
    WALL = 3


@dataclass(frozen=True)
class Primitives:
    """Shapes of a scene in columns.

    Attributes:
        forms: `(P,)` int64, `Form` of each primitive.
        rows: `(P, 7)` float64: x, y, bottom z (an ellipsoid: centre z), three sizes by `Form`, heading in radians.
        owners: `(P,)` int64, index of the obstacle in the scene; -1 for the arena's walls.
        parts: `(P,)` int64, `Part` of the obstacle.
        segments: `(P,)` uint8, number in segmentation images.
        walkers: `(W, 2)` int64, range `[first, end)` of the primitives of each walking obstacle, in order.
    """

    forms: np.ndarray
    rows: np.ndarray
    owners: np.ndarray
    parts: np.ndarray
    segments: np.ndarray
    walkers: np.ndarray

    def rows_at(self, people: np.ndarray | None) -> np.ndarray:
        """Return `rows` with the walking obstacles at the positions `people` `(W, 2)`; None: at their start."""
        if people is None or not len(self.walkers):
            return self.rows
        rows = self.rows.copy()
        for (first, last), position in zip(self.walkers, np.asarray(people, np.float64), strict=True):
            rows[first:last, :2] = position
        return rows


def primitives_of(scene: Scene) -> Primitives:
    """Return the arena's walls and every obstacle of a scene as primitives."""
    entries: list[tuple[Form, Row, int, Part, int]] = [(Form.BOX, row, -1, Part.WALL, SEGMENT_WALL) for row in _walls()]
    walkers = []
    for index, obstacle in enumerate(scene.obstacles):
        first = len(entries)
        segment = KINDS[obstacle.kind].segment_id
        entries += [(form, row, index, part, segment) for form, row, part in _obstacle(obstacle)]
        if obstacle.path:
            walkers.append((first, len(entries)))
    forms, rows, owners, parts, segments = zip(*entries, strict=True)
    return Primitives(
        np.array(forms, np.int64),
        np.array(rows, np.float64),
        np.array(owners, np.int64),
        np.array(parts, np.int64),
        np.array(segments, np.uint8),
        np.array(walkers, np.int64).reshape(-1, 2),
    )


def _walls() -> list[Row]:
    middle, thick = ARENA_HALF_M + WALL_THICKNESS_M / 2, WALL_THICKNESS_M / 2
    long = ARENA_HALF_M + WALL_THICKNESS_M
    return [(s * middle, 0.0, 0.0, WALL_HEIGHT_M, thick, long, 0.0) for s in (-1, 1)] + [
        (0.0, s * middle, 0.0, WALL_HEIGHT_M, long, thick, 0.0) for s in (-1, 1)
    ]


def _obstacle(obstacle: Obstacle) -> list[tuple[Form, Row, Part]]:
    kind, x, y = KINDS[obstacle.kind], obstacle.x_m, obstacle.y_m
    heading = np.deg2rad(obstacle.heading_deg)
    if obstacle.size_m is not None:
        length, width, height = obstacle.size_m
        if kind.shape == "box":
            return [(Form.BOX, (x, y, 0.0, height, length / 2, width / 2, heading), Part.BODY)]
        body = height * CAR_BODY_SHARE
        return [
            (Form.BOX, (x, y, 0.0, body, length / 2, width / 2, heading), Part.BODY),
            (Form.BOX, (x, y, body, height - body, length * 0.27, width * 0.43, heading), Part.TOP),
        ]
    assert obstacle.radius_m is not None, "a kind without size_m has a radius_m"
    radius, height = obstacle.radius_m, kind.height_m
    if kind.shape == "sphere":
        return [(Form.ELLIPSOID, (x, y, 0.0, radius, radius, height, 0.0), Part.BODY)]
    if kind.shape == "cone":
        return [(Form.FRUSTUM, (x, y, 0.0, height, radius, radius * TOP_SHARE, 0.0), Part.BODY)]
    if kind.shape == "tree":
        crown, half = radius * CROWN_SHARE, (height - TRUNK_HEIGHT_M) / 2
        return [
            (Form.FRUSTUM, (x, y, 0.0, TRUNK_HEIGHT_M + half / 2, radius, radius, 0.0), Part.BODY),
            (Form.ELLIPSOID, (x, y, TRUNK_HEIGHT_M + half, crown, crown, half, 0.0), Part.TOP),
        ]
    if kind.shape == "capsule":
        legs, neck = height * 0.45, height * _NECK_SHARE
        return [
            (Form.FRUSTUM, (x, y, 0.0, legs, radius, radius, 0.0), Part.LEGS),
            (Form.FRUSTUM, (x, y, legs, neck - legs, radius, radius, 0.0), Part.BODY),
            (Form.ELLIPSOID, (x, y, neck, radius, radius, height - neck, 0.0), Part.TOP),
        ]
    return [(Form.FRUSTUM, (x, y, 0.0, height, radius, radius, 0.0), Part.BODY)]
