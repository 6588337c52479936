import math

import numpy as np
import pytest

from zsdist.sim.physics.raycast import HIT_NOTHING, HIT_WALL, ray_distances

NONE3, NONE5 = np.empty((0, 3)), np.empty((0, 5))


def test_distance_to_a_circle_is_to_its_surface():
    distances, hits = ray_distances(np.array([[5.0, 0.0, 1.0]]), NONE5, 12.5, 0.0, 0.0, np.array([0.0]), 10.0)
    assert distances[0] == pytest.approx(4.0)
    assert hits[0] == 0


def test_distance_to_a_turned_box_is_to_its_near_corner():
    box = np.array([[5.0, 0.0, 2.0, 2.0, math.pi / 4]])
    distances, hits = ray_distances(np.array([[-5.0, 0.0, 1.0]]), box, 12.5, 0.0, 0.0, np.array([0.0]), 10.0)
    assert distances[0] == pytest.approx(5.0 - math.sqrt(2))
    assert hits[0] == 1  # the numbers of boxes follow those of circles


def test_rays_hit_walls_in_every_direction():
    angles = np.array([0.0, math.pi / 2, math.pi, -math.pi / 2, math.pi / 4])
    distances, hits = ray_distances(NONE3, NONE5, 12.5, 2.5, 0.5, angles, 30.0)
    assert distances == pytest.approx([10.0, 12.0, 15.0, 13.0, 10.0 * math.sqrt(2)])
    assert (hits == HIT_WALL).all()


def test_a_ray_that_hits_nothing_has_the_greatest_length():
    distances, hits = ray_distances(np.array([[9.0, 0.0, 1.0]]), NONE5, 12.5, 0.0, 0.0, np.array([0.0, 1.0]), 5.0)
    assert (distances == 5.0).all()
    assert (hits == HIT_NOTHING).all()


def test_a_ray_from_inside_an_obstacle_has_length_zero():
    for circles, boxes in (
        (np.array([[0.2, 0.0, 1.0]]), NONE5),
        (NONE3, np.array([[0.2, 0.0, 2.0, 1.0, 0.3]])),
    ):
        distances, hits = ray_distances(circles, boxes, 12.5, 0.0, 0.0, np.array([0.0, 3.0]), 5.0)
        assert (distances == 0.0).all()
        assert (hits == 0).all()


def test_distances_agree_with_marching_along_the_ray():
    rng = np.random.default_rng(1)
    for _ in range(20):
        circles = np.column_stack([rng.uniform(-8, 8, (6, 2)), rng.uniform(0.2, 1.5, 6)])
        boxes = np.column_stack([rng.uniform(-8, 8, (4, 2)), rng.uniform(0.4, 3, (4, 2)), rng.uniform(-3, 3, 4)])
        x, y, angle = *rng.uniform(-9, 9, 2), rng.uniform(-3, 3)
        t = np.arange(0, 6.0, 0.001)
        px, py = x + t * math.cos(angle), y + t * math.sin(angle)
        inside = (np.abs(px) > 12.5) | (np.abs(py) > 12.5)
        for cx, cy, r in circles:
            inside |= np.hypot(px - cx, py - cy) <= r
        for bx, by, length, width, heading in boxes:
            along = (px - bx) * math.cos(heading) + (py - by) * math.sin(heading)
            across = (py - by) * math.cos(heading) - (px - bx) * math.sin(heading)
            inside |= (np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)
        marched = t[inside.argmax()] if inside.any() else 6.0
        exact = ray_distances(circles, boxes, 12.5, x, y, np.array([angle]), 6.0)[0][0]
        assert exact == pytest.approx(marched, abs=0.002)
