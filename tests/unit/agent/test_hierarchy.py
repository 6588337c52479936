import math
from functools import partial

import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist.agent import features
from zsdist.agent.blocks import GOAL_CHOICE, HIGH_ACTIONS, NEIGHBOURS
from zsdist.agent.hierarchy import HierarchicalAgent
from zsdist.agent.recorder import Recorder
from zsdist.config import Config
from zsdist.dqn import network
from zsdist.driving.settings import agent_settings, recorder_settings
from zsdist.planning.rewards import RewardTerms
from zsdist.sim.scenes import families
from zsdist.types import NO_GUIDE, Behaviour, Level, Outcome, Pose

CONFIG = Config()
SIZES = {
    Level.LOW: (features.LOW_STATE_SIZE, features.LOW_ACTIONS),
    Level.HIGH: (features.HIGH_STATE_SIZE, HIGH_ACTIONS),
}
SCENES = [families.generate("singleton", index) for index in range(4)]


def networks(seed=0):
    return {
        level: partial(network.apply, network.initial_parameters(*size, (32,), seed)) for level, size in SIZES.items()
    }


class Drive:
    """Record of one episode: its decisions, rewards, trajectories, masks and poses."""

    def __init__(self, scene, q=None, config=CONFIG, steps=40, seed=0, recorded=True, **begin):
        self.env, visual_act = LatticeEnv(config=config), FakeVisualAct()
        self.agent = HierarchicalAgent(agent_settings(config))
        recorder = Recorder(recorder_settings(config), {Level.HIGH: 3, Level.LOW: 4}) if recorded else None
        self.decisions, self.terms, self.trajectories, self.masks, self.poses = [], [], [], [], []
        observation, info = self.env.reset(options={"scene": scene})
        settings = {"epsilon": 0.5, "shielded": True} | begin
        self.agent.begin(
            Pose(*observation["pose"]),
            tuple(observation["goal"]),
            rng=np.random.default_rng(seed),
            recorder=recorder,
            **settings,
        )
        self.outcome = None
        for step in range(steps + 1):
            pose = Pose(*observation["pose"])
            east, north = observation["goal"] - observation["pose"][:2]
            bearing = math.remainder(math.atan2(north, east) - pose.heading_rad, math.tau)
            view = visual_act(observation["image"][None], [bearing], [math.hypot(east, north)])[0]
            self.agent.observe(pose, view)
            self.poses.append(pose)
            if self.outcome or step == steps:
                break
            self.masks.append(info["action_mask"])
            decision = self.agent.act(q or networks())
            observation, _, terminated, truncated, info = self.env.step(int(decision.action))
            self.terms.append(RewardTerms(**info["reward_terms"]))
            if terminated or truncated:
                reached = Outcome.SUCCESS if info["success"] else Outcome.COLLISION
                self.outcome = reached if terminated else Outcome.TIMEOUT
            self.agent.result(self.terms[-1], self.outcome)
            self.decisions.append(decision)
            self.trajectories += recorder.drain() if recorder else []
        self.agent.finish()
        self.trajectories += recorder.drain() if recorder else []

    def of(self, level):
        return [trajectory for trajectory in self.trajectories if trajectory.level is level]


def guided(**changes):
    return CONFIG.model_copy(update={"agent": CONFIG.agent.model_copy(update={"guide_share": 1.0, **changes})})


@pytest.mark.parametrize("level", list(Level))
@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
def test_every_step_is_one_transition_of_either_level(level, scene):
    drive = Drive(scene)
    assert sum(len(trajectory) for trajectory in drive.of(level)) == len(drive.decisions) > 5
    for trajectory in drive.of(level):
        n = len(trajectory)
        assert trajectory.states.shape == (n + 1, SIZES[level][0]) and trajectory.masks.shape == (
            n + 1,
            SIZES[level][1],
        )
        assert np.isfinite(trajectory.states).all() and np.abs(trajectory.rewards).max() < 20
        assert trajectory.masks.any(axis=1).all()
        assert trajectory.masks[np.arange(n), trajectory.actions].all()
        assert (trajectory.guides != NO_GUIDE).all()
        assert trajectory.weight_version == (3 if level is Level.HIGH else 4)


def test_low_trajectories_hold_the_actions_driven_in_order():
    drive = Drive(SCENES[0])
    driven = [int(decision.action) for decision in drive.decisions]
    assert [int(action) for trajectory in drive.of(Level.LOW) for action in trajectory.actions] == driven
    behaviours = [int(behaviour) for trajectory in drive.of(Level.LOW) for behaviour in trajectory.behaviours]
    assert behaviours == [int(decision.behaviour) for decision in drive.decisions]
    assert {Behaviour.GREEDY, Behaviour.GUIDE} <= set(behaviours)


def test_all_states_of_a_low_trajectory_are_relative_to_one_subgoal():
    drive = Drive(SCENES[1], epsilon=1.0)
    subgoals = [decision.subgoal for decision in drive.decisions]
    start = 0
    polar = features.LOW_STATE_SIZE - 8
    for trajectory in drive.of(Level.LOW):
        stop = start + len(trajectory)
        assert len(set(subgoals[start:stop])) == 1
        x, y = subgoals[start]
        for state, pose in zip(trajectory.states, drive.poses[start : stop + 1], strict=True):
            assert state[polar + 2] * 5 == pytest.approx(math.hypot(x - pose.x_m, y - pose.y_m), abs=1e-3)
        start = stop


def test_an_option_is_one_high_trajectory_and_its_choice_turns_with_the_car():
    drive = Drive(SCENES[2], epsilon=1.0, config=guided())
    starts = [index for index, decision in enumerate(drive.decisions) if decision.option_started]
    assert [len(trajectory) for trajectory in drive.of(Level.HIGH)] == list(np.diff([*starts, len(drive.decisions)]))
    grid = drive.env.grid
    step = 0
    for trajectory in drive.of(Level.HIGH):
        headings = [grid.lattice_state(pose) for pose in drive.poses[step : step + len(trajectory)]]
        blocks = set()
        for state, action in zip(headings, trajectory.actions, strict=True):
            if action == GOAL_CHOICE:
                blocks.add(None)
                continue
            bx, by = grid.block_of(state.ix, state.iy)
            angle = (state.heading + int(action)) % 8 * math.pi / 4
            blocks.add((bx + round(math.cos(angle)), by + round(math.sin(angle))))
        assert len(blocks) == 1
        step += len(trajectory)


def test_options_are_never_longer_than_configured():
    drive = Drive(SCENES[0], config=guided(option_max_steps=3), epsilon=1.0)
    assert max(len(trajectory) for trajectory in drive.of(Level.HIGH)) == 3
    assert drive.agent.statistics()["options_long"] > 0


class Heard:
    """Q-functions that keep the states in which each level decides."""

    def __init__(self, **preferred):
        self.states = {level: [] for level in Level}
        self.q = {level: partial(self._values, level, values) for level, values in networks().items()}
        self._preferred = {Level(name): choice for name, choice in preferred.items()}

    def _values(self, level, values, states):
        self.states[level].append(states[0].copy())
        found = np.array(values(states))
        if level in self._preferred:
            found[:, self._preferred[level]] = 1e6
        return found


@pytest.mark.parametrize("preferred", [{}, {"high": GOAL_CHOICE}, {"high": 0}])
def test_training_and_evaluation_decide_on_the_same_states(preferred):
    config = CONFIG.model_copy(update={"agent": CONFIG.agent.model_copy(update={"option_max_steps": 3})})
    heard = Heard(**preferred), Heard(**preferred)
    for recorded, states in zip((True, False), heard, strict=True):
        Drive(SCENES[0], q=states.q, config=config, epsilon=0.0, recorded=recorded)
    for level in Level:
        trained, evaluated = (states.states[level] for states in heard)
        np.testing.assert_array_equal(trained, evaluated)


def test_each_failed_option_is_in_the_state_of_the_next_decision():
    config = CONFIG.model_copy(update={"agent": CONFIG.agent.model_copy(update={"option_max_steps": 3})})
    goal_tries = NEIGHBOURS * features.BLOCK_FEATURES + 7
    for recorded in (True, False):
        heard = Heard(high=GOAL_CHOICE)
        drive = Drive(SCENES[0], q=heard.q, config=config, epsilon=0.0, recorded=recorded)
        counted = [state[goal_tries] for state in heard.states[Level.HIGH]]
        np.testing.assert_allclose(counted, np.log1p(np.arange(len(counted))), rtol=1e-6)
        assert len(counted) > 5
        for trajectory, after in zip(drive.of(Level.HIGH), counted[1:], strict=False):
            assert trajectory.states[-1][goal_tries] == after


def test_a_crash_is_learned_as_a_crash_where_both_ends_are_paid_alike():
    reward = CONFIG.reward.model_copy(update={"goal": CONFIG.reward.step})
    config = CONFIG.model_copy(update={"reward": reward})
    ahead = Heard(low=0)
    for scene in SCENES:
        drive = Drive(scene, q=ahead.q, config=config, epsilon=0.0, shielded=False)
        if drive.outcome is Outcome.COLLISION:
            assert all(drive.of(level)[-1].rewards[-1] < -2 for level in Level)
            break
    else:
        pytest.fail("no car that drives straight ahead hit anything")


def test_nothing_is_bootstrapped_after_the_goal_and_everything_after_a_cut():
    for scene in SCENES:
        drive = Drive(scene, epsilon=1.0, config=guided(), steps=120)
        last = drive.of(Level.LOW)[-1], drive.of(Level.HIGH)[-1]
        if drive.outcome == "success":
            assert all(trajectory.discounts[-1] == 0 and trajectory.rewards[-1] > 1.5 for trajectory in last)
            break
    else:
        pytest.fail("the guides reached no goal")
    cut = Drive(SCENES[0], steps=3)
    assert cut.outcome is None
    assert all(cut.of(level)[-1].discounts[-1] > 0 for level in Level)


def test_a_greedy_choice_under_the_shield_is_the_best_allowed_one():
    values = {level: np.arange(size[1], dtype=np.float32) for level, size in SIZES.items()}
    q = {level: lambda states, level=level: np.tile(values[level], (len(states), 1)) for level in Level}
    drive = Drive(SCENES[0], q=q, epsilon=0.0, steps=25)
    step = 0
    for trajectory in drive.of(Level.LOW):
        for mask, action in zip(trajectory.masks, trajectory.actions, strict=False):
            assert action == np.flatnonzero(mask)[-1]
            assert drive.decisions[step].shield_changed == (action != 4)
            step += 1
    assert all(decision.behaviour is Behaviour.GREEDY for decision in drive.decisions)


def test_a_decision_has_the_masks_of_both_levels_and_the_values_of_those_that_decided():
    drive = Drive(SCENES[0], networks(), epsilon=0.0, recorded=False, steps=20)
    for decision in drive.decisions:
        assert (Level.HIGH in decision.values) == decision.option_started
        values, mask = decision.values[Level.LOW], decision.masks[Level.LOW]
        assert decision.action == np.where(mask, values, -np.inf).argmax()
        assert decision.masks[Level.HIGH].shape == (HIGH_ACTIONS,)


def test_without_the_shield_only_moves_off_the_grid_are_masked():
    drive = Drive(SCENES[0], shielded=False, epsilon=1.0)
    masks = [mask for trajectory in drive.of(Level.LOW) for mask in trajectory.masks[:-1]]
    assert (np.array(masks) == np.array(drive.masks)).all()
    assert not any(decision.shield_changed for decision in drive.decisions)


def test_exploration_follows_the_guide_in_the_configured_share():
    counts = np.zeros(3)
    for seed in range(3):
        for decision in Drive(SCENES[seed], epsilon=1.0, seed=seed).decisions:
            counts[decision.behaviour] += 1
    assert counts[Behaviour.GREEDY] == 0
    assert 0.65 < counts[Behaviour.GUIDE] / counts.sum() < 0.93


def test_without_a_recorder_no_guide_and_no_planner_is_asked(monkeypatch):
    def refuse(*_):
        raise AssertionError("a guide or a planner was asked")

    for name in ("guide.high_choice", "guide.LowGuide.action", "planner.CostField.costs_on"):
        monkeypatch.setattr(f"zsdist.agent.{name}", refuse)
    drive = Drive(SCENES[0], epsilon=0.0, recorded=False)
    assert len(drive.decisions) > 5 and not drive.trajectories


def test_equal_seeds_drive_alike_and_others_do_not():
    one, two, other = (Drive(SCENES[3], seed=seed) for seed in (5, 5, 6))
    assert [d.action for d in one.decisions] == [d.action for d in two.decisions]
    assert [d.action for d in one.decisions] != [d.action for d in other.decisions]


def test_the_literal_reward_is_the_papers_sum():
    config = CONFIG.model_copy(update={"reward": CONFIG.reward.model_copy(update={"literal": True})})
    drive = Drive(SCENES[0], config=config)
    rewards = np.concatenate([trajectory.rewards for trajectory in drive.of(Level.LOW)])
    np.testing.assert_allclose(rewards, [terms.total for terms in drive.terms], rtol=1e-6)


def test_the_guides_alone_reach_most_goals():
    scenes = [families.generate("iid", index) for index in range(6)]
    outcomes = [Drive(scene, epsilon=1.0, config=guided(), steps=150).outcome for scene in scenes]
    assert outcomes.count("success") >= 5


def test_statistics_are_plain_finite_numbers():
    statistics = Drive(SCENES[0]).agent.statistics()
    assert all(isinstance(value, int | float) and math.isfinite(value) for value in statistics.values())
    assert statistics["agent_steps"] == 40
    assert 0 < statistics["explored_share"] < 1 and 0 <= statistics["guide_explored_share"] <= 1


def greedy(scene, **agent):
    config = CONFIG.model_copy(update={"agent": CONFIG.agent.model_copy(update=agent)})
    return Drive(scene, config=config, steps=200, epsilon=0.0, recorded=False)


def test_planners_in_both_networks_places_arrive_whatever_the_weights():
    for index in range(3):
        scene = families.draw("iid", "validation", index)
        assert greedy(scene, high_policy="planner", low_policy="planner").outcome == "success"


def test_with_the_goal_as_the_only_subgoal_no_block_is_ever_sought():
    drive = greedy(SCENES[0], high_policy="goal")
    assert {decision.subgoal for decision in drive.decisions} == {SCENES[0].goal}
