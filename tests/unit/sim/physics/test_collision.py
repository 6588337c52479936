import math

import numpy as np
import pytest

from zsdist.planning.grid import Grid
from zsdist.sim.physics.collision import NO_BOXES, NO_CIRCLES, clearance_m, rasterise, touching
from zsdist.types import Pose

GRID = Grid()


def outline(x, y, length, width, heading, count=200):
    """Return points on the edge of a box."""
    t = np.linspace(-1, 1, count)
    one = np.ones(count)
    u = np.concatenate([t, t, one, -one]) * length / 2
    v = np.concatenate([one, -one, t, t]) * width / 2
    return np.stack(
        [x + u * math.cos(heading) - v * math.sin(heading), y + u * math.sin(heading) + v * math.cos(heading)]
    )


def inside(points, x, y, length, width, heading):
    dx, dy = points[0] - x, points[1] - y
    along, across = dx * math.cos(heading) + dy * math.sin(heading), dy * math.cos(heading) - dx * math.sin(heading)
    return (np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)


def test_clearance_to_circles_is_the_distance_between_outlines():
    rng = np.random.default_rng(0)
    for _ in range(100):
        pose = Pose(*rng.uniform(-3, 3, 2), rng.uniform(-4, 4))
        circle = np.array([[*rng.uniform(-4, 4, 2), rng.uniform(0.1, 1.2)]])
        edge = outline(*pose[:2], 2.04, 1.09, pose.heading_rad)
        gap = np.hypot(edge[0] - circle[0, 0], edge[1] - circle[0, 1]).min() - circle[0, 2]
        overlaps = gap <= 0 or inside(circle[0, :2], *pose[:2], 2.04, 1.09, pose.heading_rad)
        assert clearance_m(pose, circle, NO_BOXES) == pytest.approx(0.0 if overlaps else gap, abs=3e-3)


def test_clearance_to_boxes_is_the_distance_between_outlines():
    rng = np.random.default_rng(1)
    for _ in range(100):
        pose = Pose(*rng.uniform(-3, 3, 2), rng.uniform(-4, 4))
        box = np.array([[*rng.uniform(-4, 4, 2), *rng.uniform(0.3, 5, 2), rng.uniform(-4, 4)]])
        car = (pose.x_m, pose.y_m, 2.04, 1.09, pose.heading_rad)
        a, b = outline(*car), outline(*box[0])
        gap = np.sqrt(((a[:, :, None] - b[:, None, ::2]) ** 2).sum(axis=0)).min()
        overlaps = inside(a, *box[0]).any() or inside(b, *car).any()
        assert clearance_m(pose, NO_CIRCLES, box) == pytest.approx(0.0 if overlaps else gap, abs=2e-2)
        assert touching(pose, NO_CIRCLES, box) == overlaps


def test_boxes_that_cross_without_a_corner_inside_each_other_touch():
    long_wall = np.array([[0.0, 0.0, 10.0, 0.2, math.pi / 2]])
    assert touching(Pose(0.0, 0.0, 0.0), NO_CIRCLES, long_wall)
    assert not touching(Pose(1.13, 0.0, 0.0), NO_CIRCLES, long_wall)
    assert clearance_m(Pose(1.13, 0.0, 0.0), NO_CIRCLES, long_wall) == pytest.approx(0.01)


def test_the_nearest_of_many_counts():
    circles = np.array([[5.0, 0.0, 1.0], [0.0, 3.0, 1.0], [-8.0, 0.0, 0.5]])
    boxes = np.array([[0.0, -4.0, 1.0, 1.0, 0.0]])
    assert clearance_m(Pose(0.0, 0.0, 0.0), circles, boxes) == pytest.approx(3.0 - 1.0 - 0.545)
    assert clearance_m(Pose(0.0, 0.0, 0.0), NO_CIRCLES, NO_BOXES) == math.inf


def test_the_walls_of_the_arena_are_touched_by_a_corner():
    assert clearance_m(Pose(11.0, 0.0, 0.0), NO_CIRCLES, NO_BOXES, arena_m=25.0) == pytest.approx(0.48)
    reach = 1.02 * math.cos(math.pi / 4) + 0.545 * math.cos(math.pi / 4)
    assert not touching(Pose(12.5 - reach - 0.01, 0.0, math.pi / 4), NO_CIRCLES, NO_BOXES, arena_m=25.0)
    assert touching(Pose(12.5 - reach + 0.01, 0.0, math.pi / 4), NO_CIRCLES, NO_BOXES, arena_m=25.0)


def test_a_raster_marks_every_fine_cell_with_a_point_of_a_shape_and_none_far_from_it():
    rng = np.random.default_rng(2)
    circles = np.column_stack([rng.uniform(-12, 12, (6, 2)), rng.uniform(0.05, 1.5, 6)])
    boxes = np.column_stack([rng.uniform(-12, 12, (6, 2)), rng.uniform(0.05, 6, (6, 2)), rng.uniform(-4, 4, 6)])
    occupied = rasterise(circles, boxes, GRID)
    points = rng.uniform(-12.5, 12.5, (2, 60_000))
    hit = np.zeros(points.shape[1], dtype=bool)
    for x, y, r in circles:
        hit |= np.hypot(points[0] - x, points[1] - y) <= r
    for box in boxes:
        hit |= inside(points, *box)
    columns, rows = (np.floor((points + 12.5) / GRID.fine_m)).astype(int)
    assert occupied[rows[hit], columns[hit]].all()
    xs, ys = GRID.fine_centres()
    for iy, ix in np.argwhere(occupied):
        assert clearance_m(Pose(xs[ix], ys[iy], 0.0), circles, boxes, GRID.fine_m, GRID.fine_m) <= 0.05


def test_a_pole_thinner_than_a_fine_cell_and_a_shape_beyond_the_edge_are_marked():
    occupied = rasterise(np.array([[0.08, 0.08, 0.01], [13.0, 0.0, 0.6]]), NO_BOXES, GRID)
    assert occupied[80, 80]
    assert occupied[80, 159] and occupied.sum() > 2
