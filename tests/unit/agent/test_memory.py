from dataclasses import replace

import numpy as np
import pytest
from fakes import FakeVisualAct, LatticeEnv

from zsdist.agent.memory import START_DISC_M, EpisodeMemory
from zsdist.errors import RunError
from zsdist.planning.grid import Grid
from zsdist.sim.scenes import families
from zsdist.types import LatticeState

GRID = Grid()
SCENE = families.draw("iid", "train", 0)
(VIEW,) = FakeVisualAct()(LatticeEnv().reset(options={"scene": SCENE})[0]["image"][None], [0.0], [5.0])
HERE, AHEAD, BESIDE = LatticeState(12, 12, 0), LatticeState(13, 12, 0), LatticeState(16, 12, 0)


@pytest.fixture
def memory():
    return EpisodeMemory(GRID, GRID.pose(HERE), (8.0, -1.9), success_radius_m=0.6, camera_forward_m=1.0)


def observe(memory, *states):
    for state in states:
        situation, judgement = memory.observe(GRID.pose(state), VIEW)
    return situation, judgement


def test_every_step_counts_as_a_visit_of_its_state(memory):
    situation, _ = observe(memory, HERE, AHEAD, HERE)
    assert situation.visits[12, 12, 0] == 2 and situation.visits[12, 13, 0] == 1 and situation.visits.sum() == 3
    assert memory.revisits == 1


def test_a_block_counts_only_where_it_is_entered(memory):
    situation, _ = observe(memory, HERE, AHEAD, BESIDE, AHEAD)
    (first_x, first_y), (second_x, second_y) = GRID.block_of(12, 12), GRID.block_of(16, 12)
    assert situation.block_visits[first_y, first_x] == 2 and situation.block_visits[second_y, second_x] == 1


def test_tries_are_counted_by_block_and_for_the_goal(memory):
    memory.tries.count((2, 1))
    memory.tries.count(None)
    situation, _ = observe(memory, HERE)
    assert situation.tries.blocks[1, 2] == situation.tries.blocks.sum() == 1 and situation.tries.goal == 1


def test_the_situation_is_that_of_the_pose_and_the_judgement(memory):
    situation, judgement = observe(memory, HERE)
    assert situation.state == HERE and situation.moves is judgement.moves
    assert situation.gave_way == judgement.gave_way
    np.testing.assert_array_equal(situation.advice, VIEW.advice)


def test_the_ground_about_the_start_is_seen_and_free(memory):
    situation, _ = observe(memory, HERE)
    x, y = GRID.centre(12, 12)
    for aside in (-START_DISC_M / 2, 0.0, START_DISC_M / 2):
        fx, fy = GRID.fine_index(x, y + aside)
        assert situation.seen[fy, fx] and not situation.occupied[fy, fx]


@pytest.mark.parametrize("name", ["ray_probabilities", "clearance_m", "advice"])
def test_a_view_with_a_number_that_is_not_finite_does_not_reach_the_map(memory, name):
    wrong = getattr(VIEW, name).copy()
    wrong.ravel()[1] = np.nan
    with pytest.raises(RunError, match=f"{name} of a picture hold nan, 1 of"):
        memory.observe(GRID.pose(HERE), replace(VIEW, **{name: wrong}))
    situation, _ = observe(memory, HERE)
    assert situation.visits.sum() == 1
