"""Why there is no way, and where it is narrow."""

import math

import pytest

from zsdist.sim.scenes import families
from zsdist.sim.scenes.diagnosis import diagnose
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.sim.scenes.solvability import shortest_m

START, GOAL = Start(-8.4375, 0.3125, 0.0), (8.4375, 0.3125)


def scene_of(*obstacles):
    return Scene("made", "grass", START, GOAL, obstacles)


def wall(gap_m, middle_m=0.3125):
    """A wall across the arena at x = 0 with one gap."""
    pieces = []
    for low, high in ((-12.5, middle_m - gap_m / 2), (middle_m + gap_m / 2, 12.5)):
        pieces.append(Obstacle("box", 0.0, (low + high) / 2, None, (0.4, high - low, 2.0)))
    return pieces


@pytest.mark.parametrize("family", ["ood-layout", "ood-density", "ood-dynamic"])
def test_a_way_is_found_where_the_families_find_one(family):
    scene = families.draw(family, "test", 5)
    found = diagnose(scene)
    assert found.reason is None and found.way_m == pytest.approx(shortest_m(scene))
    assert found.narrow[0].width_m > 1.2 and found.reachable.any()


def test_the_narrowest_place_is_the_gap_and_named_by_what_stands_there():
    found = diagnose(scene_of(*wall(3.2)))
    (place,) = found.narrow
    assert found.reason is None and (place.width_m, place.x_m) == pytest.approx((3.2, 0.0), abs=0.25)
    assert place.sides == ("the box at (0.00, 7.21)", "the box at (0.00, -6.89)")


def test_a_gap_that_is_too_narrow_is_said_with_its_place_and_width():
    found = diagnose(scene_of(*wall(1.0)))
    assert found.way is None and found.way_m == math.inf and found.near is not None
    assert found.reason.startswith("too narrow: 1.00 m at (") and "1.29 m" in found.reason
    assert (found.narrow[0].x_m, found.narrow[0].y_m) == pytest.approx((0.0, 0.3125), abs=0.3)
    assert found.reachable[:, :12].any() and not found.reachable[:, 20:].any()


def test_only_places_that_the_car_cannot_avoid_are_too_narrow():
    beside = Obstacle("car", 4.5, 0.0, None, (4.2, 1.8, 1.5), 60.0)  # a smaller car would drive closely past it
    found = diagnose(scene_of(*wall(1.0, -1.0), beside))
    assert len(found.narrow) == 1 and found.narrow[0].width_m == pytest.approx(1.0, abs=0.02)


def test_a_closed_wall_is_said_to_be_closed():
    found = diagnose(scene_of(Obstacle("box", 0.0, 0.0, None, (0.4, 25.0, 2.0))))
    assert found.near is None and "close it off" in found.reason


def test_a_car_that_cannot_move_and_a_goal_that_it_does_not_fit_are_said():
    beside = Obstacle("rock", START.x_m, START.y_m + 1.0, 0.3), Obstacle("rock", START.x_m + 1.5, START.y_m, 0.3)
    found = diagnose(scene_of(*beside, Obstacle("rock", START.x_m, START.y_m - 1.0, 0.3)))
    assert found.reason.startswith("the car can make no move from its start: the rock")
    ring = [
        Obstacle("pole", GOAL[0] + 0.7 * math.cos(turn), GOAL[1] + 0.7 * math.sin(turn), 0.15)
        for turn in (0.0, 1.57, 3.14, 4.71)
    ]
    assert diagnose(scene_of(*ring)).reason.startswith("the car fits nowhere within 0.6 m of the goal: the pole")


def test_walking_people_do_not_close_a_way():
    path = ((0.0, 0.3125), (0.0, 1.0))
    person = Obstacle("person", 0.0, 0.3125, 0.3, path=path, speed_mps=1.0)
    assert diagnose(scene_of(*wall(3.2), person)).reason is None
