import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsdist.agent import shield
from zsdist.planning.belief import CEILING, FLOOR, PASS, BeliefMap
from zsdist.planning.grid import Grid
from zsdist.types import Pose, View

GRID = Grid()
EDGES = np.geomspace(0.25, 5.0, 25).astype(np.float32)
ANGLES = np.arctan(1 - 2 * (np.arange(32) + 0.5) / 32).astype(np.float32)
CAMERA_M = 1.0
ORIGIN = Pose(0.0, 0.0, 0.0)


def view_of(distances, spread=0):
    """Return a view whose rays end at given distances, each in its bin or evenly in `spread` bins to either side."""
    probabilities = np.zeros((32, 25), np.float32)
    for ray, distance in enumerate(np.broadcast_to(distances, 32)):
        if distance >= 5.0:
            probabilities[ray, -1] = 1.0
            continue
        index = int(np.searchsorted(EDGES, distance)) - 1
        probabilities[ray, max(index - spread, 0) : min(index + spread + 1, 24)] = 1.0
    probabilities /= probabilities.sum(1, keepdims=True)
    zeros = np.zeros(3, np.float32)
    return View(zeros, zeros, zeros, probabilities, ANGLES, EDGES)


def wall_ahead(distance_m):
    return view_of(distance_m / np.cos(ANGLES))


def at(cells, x_m, y_m):
    fx, fy = GRID.fine_index(x_m, y_m)
    return bool(cells[fy, fx])


@pytest.mark.parametrize("heading", np.arange(8) * math.pi / 4)
def test_a_wall_is_occupied_what_is_before_it_free_and_what_is_behind_it_unknown(heading):
    belief = BeliefMap(GRID)
    belief.update(Pose(1.0, -2.0, heading), wall_ahead(2.0), CAMERA_M)

    def ahead(cells, distance):
        return at(cells, 1.0 + distance * math.cos(heading), -2.0 + distance * math.sin(heading))

    assert ahead(belief.occupied(), CAMERA_M + 2.05)
    assert ahead(belief.seen(), CAMERA_M + 1.2) and not ahead(belief.occupied(), CAMERA_M + 1.2)
    assert not ahead(belief.seen(), CAMERA_M + 3.5)
    assert not ahead(belief.seen(), -3.0)


def test_an_imagined_obstacle_is_removed_by_views_through_it():
    belief = BeliefMap(GRID)
    for _ in range(10):
        belief.update(ORIGIN, wall_ahead(2.0), CAMERA_M)
    assert at(belief.occupied(), 3.05, 0.0)
    for _ in range(7):
        belief.update(ORIGIN, view_of(5.0), CAMERA_M)
    assert not at(belief.occupied(), 3.05, 0.0)


def test_an_obstacle_that_many_views_missed_is_believed_at_the_first_certain_hit():
    belief = BeliefMap(GRID)
    for _ in range(50):
        belief.update(ORIGIN, view_of(5.0), CAMERA_M)
    assert not at(belief.occupied(), 3.05, 0.0)
    belief.update(ORIGIN, wall_ahead(2.0), CAMERA_M)
    assert at(belief.occupied(), 3.05, 0.0)


def test_one_miss_in_five_views_does_not_clear_an_obstacle():
    belief = BeliefMap(GRID)
    for look in range(20):
        belief.update(ORIGIN, view_of(5.0) if look % 5 == 4 else wall_ahead(2.0), CAMERA_M)
    assert at(belief.occupied(), 3.05, 0.0)


def test_a_person_who_steps_onto_ground_that_was_long_free_is_believed_at_the_first_view():
    belief = BeliefMap(GRID)
    for _ in range(20):
        belief.update(ORIGIN, view_of(5.0), CAMERA_M)
    belief.update(ORIGIN, wall_ahead(2.0), CAMERA_M)
    assert at(belief.occupied(shield.DOUBTFUL.above), CAMERA_M + 2.05, 0.0)


def test_an_uncertain_ray_claims_free_ground_less_surely_than_a_certain_one():
    certain, uncertain = BeliefMap(GRID), BeliefMap(GRID)
    certain.update(ORIGIN, view_of(3.0), CAMERA_M)
    uncertain.update(ORIGIN, view_of(3.0, spread=6), CAMERA_M)
    surely = -0.9 * PASS
    assert (~uncertain.occupied(surely)).sum() < 0.8 * (~certain.occupied(surely)).sum()


def test_a_surface_at_an_uncertain_distance_closes_no_cell_that_it_more_likely_lies_beyond():
    belief = BeliefMap(GRID)
    for _ in range(5):
        belief.update(ORIGIN, view_of(3.0, spread=6), CAMERA_M)
    assert not at(belief.occupied(), CAMERA_M + 2.0, 0.0) and at(belief.seen(), CAMERA_M + 2.0, 0.0)
    assert at(belief.occupied(), CAMERA_M + 4.8, 0.0)


def test_a_thin_pole_met_by_one_ray_is_believed():
    belief = BeliefMap(GRID)
    distances = np.full(32, 5.0)
    distances[16] = 1.5
    belief.update(ORIGIN, view_of(distances), CAMERA_M)
    end_m = EDGES[np.searchsorted(EDGES, 1.5)]  # probability of its bin
    assert at(belief.occupied(), CAMERA_M + end_m * math.cos(ANGLES[16]), end_m * math.sin(ANGLES[16]))


def test_ground_under_the_car_and_in_a_cleared_disc_is_known_to_be_free():
    belief = BeliefMap(GRID)
    belief.update(Pose(3.0, 0.0, math.pi), wall_ahead(2.5), CAMERA_M)
    assert at(belief.occupied(), -0.55, 0.0)
    belief.clear_car(Pose(-0.5, 0.0, 0.0))
    assert not at(belief.occupied(), -0.55, 0.0)
    belief.clear_disc(6.0, 6.0, 1.5)
    for angle in np.arange(0, math.tau, 0.3):
        assert at(belief.seen(), 6.0 + 1.3 * math.cos(angle), 6.0 + 1.3 * math.sin(angle))
    assert not at(belief.seen(), 6.0, 7.8)


def test_a_higher_threshold_believes_less():
    belief = BeliefMap(GRID)
    belief.update(ORIGIN, view_of(3.0, spread=2), CAMERA_M)
    belief.update(ORIGIN, wall_ahead(3.0), CAMERA_M)
    assert 0 < belief.occupied(1.0).sum() < belief.occupied().sum()
    assert not (belief.occupied(1.0) & ~belief.occupied()).any()


@given(
    st.floats(-12.4, 12.4),
    st.floats(-12.4, 12.4),
    st.floats(-math.pi, math.pi),
    st.lists(st.floats(0.0, 6.0), min_size=32, max_size=32),
)
def test_any_view_from_anywhere_keeps_the_belief_within_its_bounds(x_m, y_m, heading, distances):
    belief = BeliefMap(GRID)
    belief.update(Pose(x_m, y_m, heading), view_of(np.maximum(distances, 0.26)), CAMERA_M)
    assert not belief.occupied(CEILING).any()
    assert belief.occupied(FLOOR - 1e-3).all()
    assert not (belief.occupied() & ~belief.seen()).sum() > 0.2 * max(belief.seen().sum(), 1)
