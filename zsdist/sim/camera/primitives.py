"""A scene as the few shapes both back ends draw: upright frustums, ellipsoids and boxes, all turned about z only."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from zsdist.sim.scenes.kinds import CROWN_SHARE, KINDS, SEGMENT_WALL, TOP_SHARE, TRUNK_HEIGHT_M, WALL_HEIGHT_M
from zsdist.sim.scenes.scene import Obstacle, Scene

ARENA_HALF_M = 12.5
WALL_THICKNESS_M = 0.3
CAR_BODY_SHARE = 0.58  # of a car's height; the cabin is above
_NECK_SHARE = 0.8  # of a person's height: above are shoulders and head


class Form(IntEnum):
    """What a row of `Primitives.rows` is, and what its columns 3 to 6 mean."""

    FRUSTUM = 0  # height, radius at the bottom, radius at the top
    ELLIPSOID = 1  # semi-axes in x, y, z; column 2 is the z of its centre
    BOX = 2  # height, half length, half width


class Part(IntEnum):
    """Which part of its obstacle a primitive is; appearance gives each a colour."""

    BODY = 0
    TOP = 1  # a tree's crown, a car's cabin, a person's head
    LEGS = 2
    WALL = 3


@dataclass(frozen=True)
class Primitives:
    """A scene's shapes in columns.

    Attributes:
        forms: `(P,)` int64, `Form`.
        rows: `(P, 7)` float64: x, y, bottom z (an ellipsoid: centre z), three sizes by `Form`, heading in radians.
        owners: `(P,)` int64, index of the scene's obstacle; -1 for the arena's walls.
        parts: `(P,)` int64, `Part`.
        segments: `(P,)` uint8, number in segmentation images.
        walkers: `(W, 2)` int64, for each walking obstacle in order the range `[first, last)` of its primitives.
    """

    forms: np.ndarray
    rows: np.ndarray
    owners: np.ndarray
    parts: np.ndarray
    segments: np.ndarray
    walkers: np.ndarray

    def rows_at(self, people: np.ndarray | None) -> np.ndarray:
        """`rows` with the walking obstacles moved to `people` `(W, 2)`; None leaves them where the scene has them."""
        if people is None or not len(self.walkers):
            return self.rows
        rows = self.rows.copy()
        for (first, last), place in zip(self.walkers, np.asarray(people, np.float64), strict=True):
            rows[first:last, :2] = place
        return rows


def primitives_of(scene: Scene) -> Primitives:
    """The arena's walls and every obstacle of a scene as primitives."""
    entries = [(Form.BOX, row, -1, Part.WALL, SEGMENT_WALL) for row in _walls()]
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


def _walls() -> list[tuple[float, ...]]:
    middle, thick = ARENA_HALF_M + WALL_THICKNESS_M / 2, WALL_THICKNESS_M / 2
    long = ARENA_HALF_M + WALL_THICKNESS_M
    return [(s * middle, 0.0, 0.0, WALL_HEIGHT_M, thick, long, 0.0) for s in (-1, 1)] + [
        (0.0, s * middle, 0.0, WALL_HEIGHT_M, long, thick, 0.0) for s in (-1, 1)
    ]


def _obstacle(obstacle: Obstacle) -> list[tuple[Form, tuple[float, ...], Part]]:
    kind, x, y = KINDS[obstacle.kind], obstacle.x_m, obstacle.y_m
    heading = np.deg2rad(obstacle.heading_deg)
    if not kind.round:
        length, width, height = obstacle.size_m
        if kind.shape == "box":
            return [(Form.BOX, (x, y, 0.0, height, length / 2, width / 2, heading), Part.BODY)]
        body = height * CAR_BODY_SHARE
        return [
            (Form.BOX, (x, y, 0.0, body, length / 2, width / 2, heading), Part.BODY),
            (Form.BOX, (x, y, body, height - body, length * 0.27, width * 0.43, heading), Part.TOP),
        ]
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
