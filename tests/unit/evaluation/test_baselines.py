import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist.config import Config
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.drivers import Observability, Observed
from zsdist.evaluation.episodes import EpisodeRunner
from zsdist.evaluation.oracle_view import by_camera, by_truth
from zsdist.sim.scenes import families
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Outcome, Pose

CONFIG = Config()
WALL = Obstacle("box", 1.5, 0.0, size_m=(0.6, 9.0, 2.0))
OPEN = Scene("open", "grass", Start(-5.3125, 0.3125, 0.0), (5.9375, 0.3125), ())
POCKET = Scene(
    "pocket",
    "grass",
    OPEN.start,
    OPEN.goal,
    (
        Obstacle("box", 2.0, 0.0, size_m=(0.6, 6.0, 2.0)),
        Obstacle("box", 0.0, 3.0, size_m=(4.0, 0.6, 2.0)),
        Obstacle("box", 0.0, -3.0, size_m=(4.0, 0.6, 2.0)),
    ),
)
DETOUR = Scene("detour", "grass", Start(-5.3125, 0.3125, 0.0), (6.5625, 0.3125), (WALL,))


def drive(name, scene, seed=0):
    baseline = BASELINES[name]
    see = by_camera(FakeVisualAct()) if baseline.observability is Observability.CAMERA else by_truth
    driver = baseline.make(CONFIG, see)
    runner = EpisodeRunner(LatticeEnv(config=CONFIG), CONFIG, driver, baseline.observability, lambda: 0.0)
    return runner.drive(scene, np.random.default_rng(seed))


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


@pytest.mark.parametrize("name", ["astar", "astar-frontier", "astar-vision", "potential-field"])
def test_planners_and_field_drive_round_a_wall(name):
    record = drive(name, DETOUR)
    assert record.outcome is Outcome.SUCCESS
    assert record.min_clearance_m > 0


def test_the_frontier_planner_drives_a_longer_way_than_the_planner_on_the_true_map():
    assert drive("astar-frontier", DETOUR).path_m > drive("astar", DETOUR).path_m


def test_only_astar_sees_the_true_map():
    assert {name for name, baseline in BASELINES.items() if baseline.observability is Observability.MAP} == {"astar"}


def test_every_baseline_has_one_line_of_its_own():
    lines = [baseline.line for baseline in BASELINES.values()]
    assert len(set(lines)) == len(lines) and all(line and "\n" not in line for line in lines)


def test_goal_greedy_drives_straight_at_the_goal_and_into_what_stands_there():
    assert drive("goal-greedy", OPEN).path_m == pytest.approx(drive("astar", OPEN).path_m)
    assert drive("goal-greedy", DETOUR).outcome is Outcome.COLLISION


def test_the_field_leaves_a_pocket_with_its_trail_only():
    assert drive("potential-field", POCKET).outcome is Outcome.SUCCESS
    assert drive("potential-field-no-trail", POCKET).outcome is Outcome.TIMEOUT
