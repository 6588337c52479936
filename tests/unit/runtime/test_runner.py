import math

import numpy as np
import pytest
from bundles import KINEMATIC, damaged, small_policy

from zsdist.errors import BundleError
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.workers import make_runner
from zsdist.planning.footprint import successor
from zsdist.runtime.bundle import Bundle
from zsdist.runtime.runner import BundleRunner
from zsdist.sim.scenes import families
from zsdist.types import Level, Pose

GREY = np.full((64, 64, 3), 120, np.uint8)
START, GOAL = Pose(-6.0, -6.0, 0.0), (6.0, 5.0)


@pytest.fixture(scope="module")
def bundle(small_bundle):
    return Bundle.load(small_bundle)


@pytest.fixture
def runner(bundle):
    runner = BundleRunner(bundle)
    runner.begin(START, GOAL)
    return runner


@pytest.mark.parametrize("threads", [1, 2])
def test_it_decides_as_an_evaluation_does_step_by_step(bundle, threads):
    policy, runner, compared = small_policy(), BundleRunner(bundle, threads), []
    scene = families.draw("iid", "test", 3)

    def watch(moment):
        if not compared:
            runner.begin(moment.observed.pose, moment.observed.goal)
        if moment.action is None:
            return
        ours, theirs = runner.decide(moment.observed.image, moment.observed.pose), moment.thought.decision
        compared.append((ours.action, moment.action))
        assert ours.subgoal == theirs.subgoal and ours.values.keys() == theirs.values.keys()
        for level, values in ours.values.items():
            np.testing.assert_allclose(values, theirs.values[level], atol=1e-4)
            np.testing.assert_array_equal(ours.masks[level], theirs.masks[level])

    make_runner(Contender(policy.config, policy.parameters), KINEMATIC).drive(scene, np.random.default_rng(0), watch)
    assert len(compared) > 10 and all(ours == theirs for ours, theirs in compared)


def test_an_action_ends_at_a_pose_of_the_grid(bundle, runner):
    pose = Pose(-6.1, -5.9, 0.1)
    decision = runner.decide(GREY, pose)
    end = successor(bundle.grid.lattice_state(pose), decision.action)
    assert decision.target == bundle.grid.pose(end)
    assert decision.masks[Level.LOW].shape == (5,) and decision.values[Level.LOW].dtype == np.float32


def test_a_picture_of_another_size_gives_the_same_map(bundle, runner):
    large = BundleRunner(bundle)
    large.begin(START, GOAL)
    runner.decide(GREY, START)
    large.decide(np.full((480, 480, 3), 120, np.uint8), START)
    np.testing.assert_array_equal(runner.belief.occupied(), large.belief.occupied())


def test_within_the_radius_of_the_goal_it_has_arrived(runner):
    decision = runner.decide(GREY, Pose(6.3, 5.3, 1.0))
    assert decision.arrived and decision.action is None and decision.target is None and decision.no_way is None


def test_after_as_many_actions_as_it_may_take_it_says_that_there_is_no_way(small_bundle, tmp_path):
    folder = damaged(small_bundle, tmp_path, lambda about: about["limits"].update(max_steps=3))
    runner = BundleRunner(Bundle.load(folder))
    runner.begin(START, GOAL)
    assert all(runner.decide(GREY, START).action is not None for _ in range(3))
    decision = runner.decide(GREY, START)
    assert decision.action is None and not decision.arrived and "3 actions" in decision.no_way


def test_a_new_goal_keeps_the_map_and_a_new_beginning_forgets_it(runner):
    runner.decide(GREY, START)
    seen = runner.belief.seen()
    runner.set_goal((-2.0, 3.0))
    decision = runner.decide(GREY, START)
    assert decision.action is not None and runner.actions_taken == 1
    assert (runner.belief.seen() >= seen).all() and seen.sum() > 0
    runner.begin(Pose(5.0, 5.0, 0.0), (-5.0, -5.0))
    assert not (runner.belief.seen() & seen)[:40, :40].any()


@pytest.mark.parametrize("goal", [(10.0, 0.0), (0.0, -10.01), (math.nan, 0.0)])
def test_a_goal_off_the_grid_is_refused_in_one_line(runner, goal):
    for call in (lambda: runner.begin(START, goal), lambda: runner.set_goal(goal)):
        with pytest.raises(BundleError, match="off the policy's grid; allowed is -10 to below 10 m"):
            call()


@pytest.mark.parametrize("pose", [Pose(12.6, 0.0, 0.0), Pose(0.0, math.nan, 0.0), Pose(0.0, 0.0, math.inf)])
def test_a_pose_outside_the_arena_is_refused(runner, pose):
    with pytest.raises(BundleError, match=r"pose is .*; allowed is within 12.5 m"):
        runner.decide(GREY, pose)


@pytest.mark.parametrize(
    "picture",
    [GREY[:, :48], GREY[:16, :16], GREY.astype(np.float32), GREY[..., 0], GREY[None], np.zeros((64, 64, 4), np.uint8)],
)
def test_a_picture_that_is_none_is_refused(runner, picture):
    with pytest.raises(BundleError, match=r"picture is .*; allowed is \(px, px, 3\) uint8"):
        runner.decide(picture, START)


def test_nothing_is_decided_before_a_beginning(bundle):
    runner = BundleRunner(bundle)
    for call in (lambda: runner.decide(GREY, START), lambda: runner.set_goal(GOAL), lambda: runner.belief):
        with pytest.raises(BundleError, match="no drive has begun"):
            call()
