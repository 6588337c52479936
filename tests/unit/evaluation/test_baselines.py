import math

import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist.config import Config
from zsdist.evaluation import baselines
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.drivers import RANGE_ANGLES_RAD, Observed, Sees
from zsdist.evaluation.episodes import Examiner
from zsdist.planning.belief import BeliefMap
from zsdist.planning.grid import Grid
from zsdist.sim import families
from zsdist.sim.scene import Obstacle, Scene, Start
from zsdist.types import Outcome, Pose

CONFIG = Config()
WALL = Obstacle("box", 1.5, 0.0, size_m=(0.6, 9.0, 2.0))
DETOUR = Scene("detour", "grass", Start(-5.3125, 0.3125, 0.0), (6.5625, 0.3125), (WALL,))


def drive(name, scene, seed=0):
    baseline = BASELINES[name]
    driver = baseline.make(CONFIG, FakeVisualAct())
    examiner = Examiner(LatticeEnv(config=CONFIG), CONFIG, driver, baseline.sees, lambda: 0.0)
    return examiner.drive(scene, np.random.default_rng(seed))


def observed(allowed) -> Observed:
    return Observed(np.zeros((1, 1, 3), np.uint8), Pose(0, 0, 0), (1.0, 1.0), np.array(allowed, dtype=bool))


def test_random_draws_every_allowed_action_and_no_other():
    driver = BASELINES["random"].make(CONFIG, None)
    driver.begin(Pose(0, 0, 0), (1.0, 1.0), None, np.random.default_rng(0))
    drawn = [driver.act(observed([1, 0, 1, 0, 1])) for _ in range(300)]
    counts = np.bincount(drawn, minlength=5)
    assert counts[[1, 3]].sum() == 0 and counts[[0, 2, 4]].min() > 70


def test_random_repeats_with_its_seed():
    scene = families.draw("iid", "test", 3)
    assert drive("random", scene, seed=5).poses == drive("random", scene, seed=5).poses
    assert drive("random", scene, seed=5).poses != drive("random", scene, seed=6).poses


@pytest.mark.parametrize("index", range(3))
def test_astar_drives_the_shortest_way_to_the_goal(index):
    record = drive("astar", families.draw("iid", "test", index))
    assert record.outcome is Outcome.SUCCESS
    assert record.path_m == pytest.approx(record.shortest_m, abs=1e-6)


def test_astar_refuses_to_drive_without_the_map():
    with pytest.raises(ValueError, match="needs the scene"):
        BASELINES["astar"].make(CONFIG, None).begin(Pose(0, 0, 0), (1.0, 1.0), None, np.random.default_rng(0))


@pytest.mark.parametrize("name", ["astar", "astar-frontier", "potential-field"])
def test_planners_and_field_come_round_a_wall(name):
    record = drive(name, DETOUR)
    assert record.outcome is Outcome.SUCCESS
    assert record.min_clearance_m > 0


def test_what_was_not_seen_costs_the_frontier_planner_a_longer_way():
    assert drive("astar-frontier", DETOUR).path_m > drive("astar", DETOUR).path_m


def test_only_astar_sees_the_true_map():
    assert {name for name, baseline in BASELINES.items() if baseline.sees is Sees.MAP} == {"astar"}


def test_every_baseline_has_one_line_of_its_own():
    lines = [baseline.line for baseline in BASELINES.values()]
    assert len(set(lines)) == len(lines) and all(line and "\n" not in line for line in lines)


def test_true_distances_become_a_map_of_the_surface_they_met():
    belief = BeliefMap(Grid.from_config(CONFIG.grid))
    pose = Pose(0.0, 0.0, 0.0)
    ahead = 3.0 / np.cos(RANGE_ANGLES_RAD)  # a wall across, 3 m ahead of the camera
    belief.update(pose, baselines.view_of_ranges(np.minimum(ahead, 5.0)), 0.0)
    grid = belief.grid

    def at(x_m, y_m):
        fx, fy = grid.fine_index(x_m, y_m)
        return bool(belief.occupied()[fy, fx]), bool(belief.seen()[fy, fx])

    assert at(3.05, 0.0) == (True, True)
    assert at(2.5, 0.5) == (False, True)
    assert at(4.6, 0.0)[1] is False  # behind the wall
    assert at(0.0, 3.0)[1] is False  # beside the view


def test_a_distance_at_the_range_is_free():
    view = baselines.view_of_ranges(np.full(len(RANGE_ANGLES_RAD), 5.0))
    assert (view.ray_probabilities[:, -1] == 1).all()
    assert math.isclose(view.ray_probabilities.sum(), len(RANGE_ANGLES_RAD))
