import math

import numpy as np
import pytest

from zsdist.config import Config
from zsdist.evaluation.oracle_view import TRUE_ANGLES_RAD, certain, true_view
from zsdist.planning.belief import BeliefMap
from zsdist.planning.grid import Grid
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Pose

CONFIG = Config()
WALL = Obstacle("box", 4.5, 0.0, size_m=(1.0, 12.0, 2.0))  # its near face 3 m ahead of the camera of a car at 0, 0
SCENE = Scene("wall", "grass", Start(0.0, 0.0, 0.0), (0.0, 8.0), (WALL,))


def view(scene=SCENE, people=None):
    return true_view(scene, Pose(0.0, 0.0, 0.0), CONFIG.camera, CONFIG.grid.arena_m, people)


def test_true_distances_become_a_map_of_the_surface_they_met():
    belief = BeliefMap(Grid.from_config(CONFIG.grid))
    belief.update(Pose(0.0, 0.0, 0.0), view(), CONFIG.camera.forward_m)

    def at(x_m, y_m):
        fx, fy = belief.grid.fine_index(x_m, y_m)
        return bool(belief.occupied()[fy, fx]), bool(belief.seen()[fy, fx])

    assert at(4.05, 0.0) == (True, True)
    assert at(3.5, 0.5) == (False, True)
    assert at(5.6, 0.0)[1] is False  # behind the wall
    assert at(1.0, 3.0)[1] is False  # beside the view


def test_the_true_advice_is_against_the_wall_and_for_the_side_of_the_goal():
    forward, left, right = view().advice
    assert left > right and left > forward
    free = true_view(Scene("free", "grass", SCENE.start, (10.0, 0.0), ()), Pose(0, 0, 0), CONFIG.camera, 25.0, None)
    assert free.advice[0] > forward


def test_walking_people_are_seen_where_they_are_now():
    person = Obstacle("person", 3.0, 0.0, radius_m=0.3, path=((3.0, 0.0), (3.0, 4.0)), speed_mps=0.8)
    scene = Scene("person", "grass", SCENE.start, SCENE.goal, (person,))
    middle = len(TRUE_ANGLES_RAD) // 2
    here, gone = view(scene), view(scene, np.array([[3.0, 4.0]]))
    assert here.ray_probabilities[middle].argmax() < gone.ray_probabilities[middle].argmax()
    assert here.dynamic[0] == 1.0


def test_a_distance_at_the_range_is_free():
    rays = certain(np.full(len(TRUE_ANGLES_RAD), 5.0))
    assert (rays[:, -1] == 1).all()
    assert math.isclose(rays.sum(), len(TRUE_ANGLES_RAD))


def test_every_true_distance_lies_in_its_bin():
    distances = np.linspace(0.01, 4.9, 50)
    bins = certain(distances).argmax(1)
    edges = np.linspace(0.05, 5.0, 100)
    assert edges[bins[1:]] == pytest.approx(distances[1:], abs=0.05)
