import dataclasses
import itertools
import math

import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist.agent.memory import START_DISC_M
from zsdist.config import Config, load
from zsdist.evaluation.contenders import VARIANTS
from zsdist.evaluation.drivers import Driver, LearnedDriver, Observability
from zsdist.evaluation.episodes import Course, EpisodeRunner
from zsdist.evaluation.oracle_view import TRUE_EDGES_M, by_camera
from zsdist.planning.belief import BeliefMap
from zsdist.planning.footprint import FootprintTable
from zsdist.planning.grid import Grid
from zsdist.run import program
from zsdist.sim.scenes import families
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Action, Level, Outcome
from zsdist.vision.ray_ablation import ablate_rays

CONFIG = Config()
TABLE = FootprintTable(Grid.from_config(CONFIG.grid))
OPEN = Scene("open", "grass", Start(-5.3125, 0.3125, 0.0), (5.9375, 0.3125), ())
POLE = Scene("pole", "grass", OPEN.start, OPEN.goal, (Obstacle("pole", 0.0, 0.3125, radius_m=0.2),))
BESIDE_GOAL = (((2.5, 0.0), (0.5, 5.5, 2.0)), ((-2.5, 0.0), (0.5, 5.5, 2.0)))
BEFORE_GOAL = (((0.0, 2.5), (5.5, 0.5, 2.0)), ((0.0, -2.5), (5.5, 0.5, 2.0)))
SHUT_IN = Scene(
    "shut in",
    "grass",
    OPEN.start,
    OPEN.goal,
    tuple(Obstacle("box", 5.9375 + x, 0.3125 + y, size_m=size) for (x, y), size in BESIDE_GOAL + BEFORE_GOAL),
)


class Scripted(Driver):
    """Driver that repeats a list of actions, and records its observations."""

    def __init__(self, *actions):
        self.actions, self.seen, self.results, self.truth = actions, [], [], None

    def begin(self, pose, goal, truth, rng):
        self.queue, self.truth = itertools.cycle(self.actions), truth

    def act(self, observed):
        self.seen.append(observed)
        return next(self.queue)

    def result(self, terms, outcome):
        self.results.append((terms, outcome))


def examine(driver, scene, observability=Observability.NOTHING, config=CONFIG, clock=lambda: 0.0):
    return EpisodeRunner(LatticeEnv(config=config), config, driver, observability, clock).drive(
        scene, np.random.default_rng(0)
    )


def test_a_straight_drive_to_the_goal_is_a_success_without_detour():
    record = examine(Scripted(Action.FORWARD), OPEN)
    assert (record.outcome, record.steps, record.fewest_steps) == (Outcome.SUCCESS, 18, 18)
    assert record.path_m == pytest.approx(11.25) and record.shortest_m == pytest.approx(11.25)
    assert record.remaining_m == 0.0 and record.static and len(record.poses) == 19


def test_driving_into_an_obstacle_is_a_collision_with_the_rest_of_the_way_remaining():
    record = examine(Scripted(Action.FORWARD), POLE)
    assert record.outcome is Outcome.COLLISION and record.min_clearance_m == 0.0
    assert 5.0 < record.remaining_m < 10.0


def test_turning_on_the_spot_until_the_step_limit_is_a_timeout():
    config = load(overrides=("sim.max_steps=7",))
    record = examine(Scripted(Action.TURN_LEFT_90), OPEN, config=config)
    assert (record.outcome, record.steps, record.path_m) == (Outcome.TIMEOUT, 7, pytest.approx(0.0))
    assert record.remaining_m == pytest.approx(record.shortest_m)


def test_clearance_is_the_least_along_the_way():
    scene = Scene("beside", "grass", OPEN.start, OPEN.goal, (Obstacle("pole", 0.0, 2.0, radius_m=0.2),))
    record = examine(Scripted(Action.FORWARD), scene)
    assert record.min_clearance_m == pytest.approx(2.0 - 0.3125 - 0.2 - 1.09 / 2, abs=0.02)


def test_decisions_are_timed_by_the_clock():
    ticks = itertools.count(step=0.25)
    record = examine(Scripted(Action.FORWARD), OPEN, clock=lambda: next(ticks))
    assert record.decision_ms == (250.0,) * 18


@pytest.mark.parametrize(
    ("observability", "map_shown", "truth_shown"),
    [
        (Observability.NOTHING, False, False),
        (Observability.CAMERA, False, False),
        (Observability.RANGES, False, True),
        (Observability.MAP, True, False),
    ],
)
def test_a_driver_observes_only_what_it_declared(observability, map_shown, truth_shown):
    driver = Scripted(Action.FORWARD)
    examine(driver, POLE, observability)
    assert (driver.truth is not None) == map_shown
    assert all((observed.truth is not None) == truth_shown for observed in driver.seen)


def test_true_distances_are_those_of_the_camera_at_its_place():
    driver = Scripted(Action.FORWARD)
    examine(driver, POLE, Observability.RANGES)
    middle = [TRUE_EDGES_M[observed.truth.ray_probabilities[45].argmax()] for observed in driver.seen]
    expected = [min(5.0, -0.2 - (observed.pose.x_m + CONFIG.camera.forward_m)) for observed in driver.seen]
    assert middle == pytest.approx(expected, abs=0.05)


def test_the_result_of_each_action_is_reported_to_the_driver():
    driver = Scripted(Action.FORWARD)
    examine(driver, OPEN)
    assert [outcome for _, outcome in driver.results] == [None] * 17 + [Outcome.SUCCESS]
    assert driver.results[-1][0].goal == CONFIG.reward.goal


def test_a_goal_without_a_way_has_no_length():
    course = Course(SHUT_IN, TABLE, CONFIG.sim.success_radius_m)
    assert course.length_m(SHUT_IN.start.pose) is None and course.fewest_steps() is None


def learned(config=CONFIG, **parts):
    parameters = {level: program.make_learner(config, level).parameters() for level in Level}
    return LearnedDriver(config, parameters, by_camera(FakeVisualAct()), **parts)


def test_the_learned_driver_is_greedy_so_randomness_changes_nothing():
    config = load(overrides=("sim.max_steps=25",))
    runner = EpisodeRunner(LatticeEnv(config=config), config, learned(config), Observability.CAMERA, lambda: 0.0)
    first, second = (runner.drive(POLE, np.random.default_rng(seed)) for seed in (1, 2))
    assert first.poses == second.poses and math.isfinite(first.path_m)


def test_the_learned_driver_counts_changes_by_the_shield_for_each_episode():
    config = load(overrides=("sim.max_steps=25",))
    runner = EpisodeRunner(LatticeEnv(config=config), config, learned(config), Observability.CAMERA, lambda: 0.0)
    first, second = (runner.drive(POLE, np.random.default_rng(0)) for _ in range(2))
    assert first.shield_changes == second.shield_changes <= first.steps


def test_a_watcher_is_shown_every_decision_with_its_situation_and_then_the_end():
    config = load(overrides=("sim.max_steps=5",))
    moments = []
    runner = EpisodeRunner(LatticeEnv(config=config), config, learned(config), Observability.CAMERA, lambda: 0.0)
    record = runner.drive(POLE, np.random.default_rng(0), moments.append)
    assert [moment.observed.pose for moment in moments] == list(record.poses)
    assert [int(moment.thought.decision.action) for moment in moments[:-1]] == [m.action for m in moments[:-1]]
    grid = Grid.from_config(config.grid)
    assert [m.thought.situation.state for m in moments[:-1]] == [grid.lattice_state(p) for p in record.poses[:-1]]
    assert [moment.outcome for moment in moments] == [None] * record.steps + [record.outcome]


def test_watching_does_not_change_an_episode():
    config = load(overrides=("sim.max_steps=25",))
    runner = EpisodeRunner(LatticeEnv(config=config), config, learned(config), Observability.CAMERA, lambda: 0.0)
    first = runner.drive(POLE, np.random.default_rng(0))
    assert runner.drive(POLE, np.random.default_rng(0), lambda moment: None) == first


def test_shuffled_advice_depends_on_the_seed_of_the_episode():
    config = load(overrides=("sim.max_steps=25", "seed=1"))  # with this seed, the advice changes an action
    driver = learned(config, shuffled=("advice",))
    runner = EpisodeRunner(LatticeEnv(config=config), config, driver, Observability.CAMERA, lambda: 0.0)
    plain = examine(learned(config), POLE, Observability.CAMERA, config).poses
    one, two, again = (runner.drive(POLE, np.random.default_rng(seed)).poses for seed in (1, 2, 1))
    assert one == again and len({plain, one, two}) > 1


def test_shuffled_rays_lead_to_another_map():
    config = load(overrides=("sim.max_steps=1",))
    scene = families.draw("iid", "validation", 0)
    plain, shuffled = learned(config), learned(config, shuffled=VARIANTS["shuffled-vision"].shuffled)
    for driver in (plain, shuffled):
        examine(driver, scene, Observability.CAMERA, config)
    assert (plain.thought.situation.occupied != shuffled.thought.situation.occupied).any()


def test_without_the_shield_nothing_is_changed():
    config = load(overrides=("sim.max_steps=25",))
    shielded, bare = (examine(learned(config, shielded=on), POLE, Observability.CAMERA, config) for on in (True, False))
    assert bare.shield_changes == 0 < shielded.shield_changes


@pytest.mark.parametrize("rays", ["three", "none"])
def test_the_learned_driver_limits_its_views_after_shuffling_them(rays):
    config = load(overrides=("sim.max_steps=1", f"vision.rays={rays}"))
    scene = families.draw("iid", "validation", 0)
    expected, seen = BeliefMap(Grid.from_config(config.grid)), []
    driver = learned(config, shuffled=("advice", "clearance_m"))
    record = EpisodeRunner(LatticeEnv(config=config), config, driver, Observability.CAMERA, lambda: 0.0).drive(
        scene, np.random.default_rng(3), seen.append
    )
    rng = np.random.default_rng(3)
    view = by_camera(FakeVisualAct())(seen[0].observed)
    view = dataclasses.replace(view, advice=rng.permutation(view.advice), clearance_m=rng.permutation(view.clearance_m))
    view = ablate_rays(view, rays)
    expected.clear_disc(record.poses[0].x_m, record.poses[0].y_m, START_DISC_M)
    expected.update(record.poses[0], view, config.camera.forward_m)
    np.testing.assert_array_equal(driver.thought.situation.advice, view.advice)
    np.testing.assert_array_equal(driver.thought.situation.occupied, expected.occupied())
