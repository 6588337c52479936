import numpy as np
import pytest

from zsdist.agent import reach
from zsdist.planning.footprint import successor
from zsdist.types import LatticeState


def world(cells, seed, share):
    """Random blocked actions; those that end off the grid always are."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((cells, cells, 8, 5)) < share
    for iy, ix, heading, action in np.ndindex(blocked.shape):
        end = successor(LatticeState(ix, iy, heading), action)
        blocked[iy, ix, heading, action] |= not (0 <= end.ix < cells and 0 <= end.iy < cells)
    return rng, blocked


def walked(blocked, start):
    """States to which a way leads, one step at a time."""
    found, queue = {start}, [start]
    for state in queue:
        for action in np.flatnonzero(~blocked[state.iy, state.ix, state.heading]):
            end = successor(state, int(action))
            if end not in found:
                found.add(end)
                queue.append(end)
    return found


@pytest.mark.parametrize(("cells", "share"), [(6, 0.3), (12, 0.6), (12, 0.8), (32, 0.7), (70, 0.72)])
def test_cells_from_a_state_are_those_that_walking_finds(cells, share):
    for seed in range(3):
        rng, blocked = world(cells, seed, share)
        start = LatticeState(*rng.integers(0, cells, 2).tolist(), int(rng.integers(8)))
        found = reach.cells_from(blocked, start)
        expected = np.zeros((cells, cells), bool)
        for state in walked(blocked, start):
            expected[state.iy, state.ix] = True
        assert (found == expected).all()


@pytest.mark.parametrize(("cells", "share"), [(6, 0.3), (12, 0.6), (12, 0.8), (70, 0.72)])
def test_states_to_a_place_are_those_from_which_walking_comes_there(cells, share):
    rng, blocked = world(cells, 5, share)
    goals = np.zeros((cells, cells), bool)
    goals[tuple(rng.integers(0, cells, (2, 3)))] = True
    leading = reach.states_to(blocked, goals)
    assert 0.02 < leading.mean() <= 1.0
    for _ in range(60):
        state = LatticeState(*rng.integers(0, cells, 2).tolist(), int(rng.integers(8)))
        arrives = any(goals[end.iy, end.ix] for end in walked(blocked, state))
        assert leading[state.iy, state.ix, state.heading] == arrives


def test_a_place_that_nothing_leads_to_is_reached_from_itself_only():
    blocked = np.ones((8, 8, 8, 5), bool)
    goals = np.zeros((8, 8), bool)
    goals[3, 4] = True
    leading = reach.states_to(blocked, goals)
    assert leading[3, 4].all() and leading.sum() == 8
    assert reach.cells_from(blocked, LatticeState(4, 3, 0)).sum() == 1
