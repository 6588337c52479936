"""Cover of occupied cells by boxes and discs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from zsdist.errors import SceneError
from zsdist.sim.maps import kernels
from zsdist.sim.maps.cover import Disc, Slab, cover

SIDE = 160  # cells of a test's map
CELL_M = 0.05


def drawn(shapes, cell_m=CELL_M, side=SIDE):
    marks = np.zeros((side, side), np.int16)
    for shape in shapes:
        at = (shape.x_m / cell_m, shape.y_m / cell_m)
        if isinstance(shape, Disc):
            kernels.mark_disc(marks, *at, shape.radius_m / cell_m, 1)
        else:
            half = (shape.length_m / 2 / cell_m, shape.width_m / 2 / cell_m)
            kernels.mark_box(marks, *at, *half, shape.angle_rad, 1)
    return marks > 0


def farthest_m(occupied, covered, cell_m=CELL_M):
    """Distance of the farthest occupied cell to the cover, and of the farthest covered cell to the map."""
    return tuple(
        float(distance_transform_edt(~other)[one].max(initial=0.0)) * cell_m
        for one, other in ((occupied, covered), (covered, occupied))
    )


@pytest.mark.parametrize(
    "shapes",
    [
        [Disc(4.0, 4.0, 1.0)],
        [Slab(4.0, 4.0, 3.0, 0.6, 0.4)],
        [Slab(4.0, 3.0, 6.0, 0.4, 0.0), Slab(1.2, 4.8, 4.0, 0.4, math.pi / 2)],  # walls that meet in a corner
        [Disc(3.0, 4.0, 1.0), Disc(4.9, 4.0, 0.8), Disc(4.0, 5.5, 0.7)],  # trees that touch
        [Slab(4.0, 4.0, 6.0, 0.3, 0.5), Slab(4.0, 4.0, 5.0, 0.3, 0.5 + math.pi / 2)],  # a cross
    ],
)
def test_shapes_are_found_again(shapes):
    occupied = drawn(shapes)
    found = cover(occupied, CELL_M, 0.05, 500)
    covered = drawn(found)
    assert len(found) == len(shapes)
    assert (occupied ^ covered).sum() <= 0.03 * occupied.sum()
    assert max(farthest_m(occupied, covered)) <= 2 * CELL_M


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.floats(0.02, 0.3))
def test_whatever_the_map_every_occupied_cell_is_within_the_tolerance(seed, share):
    rng = np.random.default_rng(seed)
    occupied = np.kron(rng.random((12, 12)) < share, np.ones((3, 3))) > 0
    covered = drawn(cover(occupied, CELL_M, 0.05, 500), side=36)
    assert farthest_m(occupied, covered)[0] <= 0.05 + CELL_M
    assert farthest_m(occupied, covered)[1] <= 0.05 + CELL_M


def test_a_ragged_wall_becomes_few_boxes():
    rng = np.random.default_rng(1)
    occupied = np.zeros((60, 120), bool)
    occupied[28:32, 5:115] = True
    occupied[27, 5:115] = rng.random(110) < 0.5
    occupied[32, 5:115] = rng.random(110) < 0.3
    found = cover(occupied, CELL_M, 0.05, 500)
    assert len(found) <= 3


def test_nothing_occupied_needs_nothing_and_too_many_are_refused():
    empty = np.zeros((20, 20), bool)
    assert cover(empty, CELL_M, 0.05, 500) == []
    dots = empty.copy()
    dots[::4, ::4] = True
    with pytest.raises(SceneError, match="more than 7 boxes and rocks"):
        cover(dots, CELL_M, 0.05, 7)
