import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsdist.planning.potential import BODY_M, action_along, attraction, force, repulsion
from zsdist.types import Action

LITERAL = {"k_att": 1.3, "k_rep": 0.7, "influence_m": 1.5, "conic": False}
EVERY = np.ones(5, bool)
NOTHING = np.empty((0, 2))


def test_eq14_attraction_is_half_k_times_the_square_of_the_distance():
    assert attraction(3.0, 2.0) == pytest.approx(9.0)
    assert attraction(0.0, 2.0) == 0.0


def test_eq15_repulsion_acts_within_its_influence_only():
    assert repulsion(0.5, 2.0, 1.0) == pytest.approx(0.5 * 2.0 * (2.0 - 1.0) ** 2)
    assert repulsion(1.0, 2.0, 1.0) == 0.0
    assert repulsion(1.01, 2.0, 1.0) == 0.0


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.2, 2.5), st.floats(-math.pi, math.pi))
def test_eq16_force_is_minus_the_gradient_of_the_potential(x, y, room, bearing):
    position, target = np.array([x, y]), (4.0, 1.0)
    obstacle = position + (BODY_M + room) * np.array([math.cos(bearing), math.sin(bearing)])

    def potential(place):
        left = math.dist(place, obstacle) - BODY_M
        return attraction(math.dist(place, target), 1.3) + repulsion(left, 0.7, 1.5)

    if abs(room - 1.5) < 1e-3:
        return  # the force has a kink there
    step = 1e-6
    gradient = [
        (potential(position + step * axis) - potential(position - step * axis)) / (2 * step) for axis in np.eye(2)
    ]
    found = force(tuple(position), target, obstacle[None], **LITERAL)
    assert found == pytest.approx(-np.array(gradient), rel=1e-3, abs=1e-3)


def test_conic_attraction_is_as_strong_far_away_as_close_by():
    near, far = (force((0.0, 0.0), (d, 0.0), NOTHING, k_att=1.0, k_rep=1.0, influence_m=1.5) for d in (1.0, 9.0))
    assert list(near) == pytest.approx([1.0, 0.0])
    assert list(far) == pytest.approx([1.0, 0.0])


def test_the_trail_pushes_away_from_where_the_car_has_been():
    settings = {"k_att": 1.0, "k_rep": 1.0, "influence_m": 1.5}
    trail = np.array([[0.0, 0.6], [0.0, 0.6]])
    assert force((0.0, 0.0), (5.0, 0.0), NOTHING, trail=trail, k_trail=0.5, **settings)[1] < -0.3
    assert force((0.0, 0.0), (5.0, 0.0), NOTHING, trail=trail, k_trail=0.0, **settings)[1] == 0.0


@pytest.mark.parametrize(
    ("degrees", "action"),
    [
        (0, Action.FORWARD),
        (20, Action.FORWARD),
        (45, Action.LEFT_45),
        (-45, Action.RIGHT_45),
        (100, Action.TURN_LEFT_90),
        (-100, Action.TURN_RIGHT_90),
    ],
)
@pytest.mark.parametrize("heading", [0.0, 2.0, -3.0])
def test_a_direction_becomes_the_action_that_points_along_it(degrees, action, heading):
    bearing = heading + math.radians(degrees)
    assert action_along(np.array([math.cos(bearing), math.sin(bearing)]), heading, EVERY) is action


def test_a_masked_action_is_never_taken_and_none_is_taken_if_none_is_allowed():
    ahead = np.array([1.0, 0.0])
    assert action_along(ahead, 0.0, np.array([False, True, False, True, True])) is Action.LEFT_45
    assert action_along(ahead, 0.0, np.zeros(5, bool)) is None


def test_reluctance_turns_a_close_decision():
    direction = np.array([math.cos(0.35), math.sin(0.35)])
    assert action_along(direction, 0.0, EVERY) is Action.FORWARD
    assert action_along(direction, 0.0, EVERY, np.array([0.5, 0, 0, 0, 0])) is Action.LEFT_45
