import numpy as np
import pytest

from zsdist.agent.reward_shaping import path_costs
from zsdist.planning import forward_search
from zsdist.planning.footprint import successor
from zsdist.planning.grid import Grid
from zsdist.planning.lattice import flat_state, successors_or_self
from zsdist.planning.shortest_path import STEPS_COST, cost_to_go
from zsdist.types import LatticeState


def world(cells, seed, share):
    """Return random blocked actions; those that end off the grid are always blocked."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((cells, cells, 8, 5)) < share
    for iy, ix, heading, action in np.ndindex(blocked.shape):
        end = successor(LatticeState(ix, iy, heading), action)
        blocked[iy, ix, heading, action] |= not (0 <= end.ix < cells and 0 <= end.iy < cells)
    return rng, blocked


def walked(blocked, start):
    """Return the states to which a path leads, found one step at a time."""
    found, queue = {start}, [start]
    for state in queue:
        for action in np.flatnonzero(~blocked[state.iy, state.ix, state.heading]):
            end = successor(state, int(action))
            if end not in found:
                found.add(end)
                queue.append(end)
    return found


@pytest.mark.parametrize(("cells", "share"), [(6, 0.3), (12, 0.6), (12, 0.8), (32, 0.7), (70, 0.72)])
def test_cells_at_a_finite_distance_are_those_that_single_steps_reach(cells, share):
    for seed in range(3):
        rng, blocked = world(cells, seed, share)
        start = LatticeState(*rng.integers(0, cells, 2).tolist(), int(rng.integers(8)))
        found = np.isfinite(forward_search.path_lengths_from(blocked, start, STEPS_COST))
        expected = np.zeros((cells, cells), bool)
        for state in walked(blocked, start):
            expected[state.iy, state.ix] = True
        assert (found == expected).all()


def test_the_path_into_a_cell_is_as_long_as_the_path_found_backwards_from_that_cell():
    costs = path_costs(Grid(cells=12, blocks=3))
    rng, blocked = world(12, 7, 0.5)
    start = LatticeState(3, 5, 2)
    forth = forward_search.path_lengths_from(blocked, start, costs)
    for iy, ix in rng.integers(0, 12, (20, 2)):
        there = np.zeros((12, 12), bool)
        there[iy, ix] = True
        assert forth[iy, ix] == pytest.approx(cost_to_go(blocked, there, costs)[start.iy, start.ix, start.heading])


def test_states_farther_than_the_limit_are_left_out():
    _, blocked = world(12, 7, 0.5)
    start = flat_state(LatticeState(3, 5, 2), 12)
    whole, near = np.full((2, 12 * 12 * 8), np.inf)
    forward_search.spread_costs(blocked.ravel(), successors_or_self(12), STEPS_COST, start, np.inf, whole)
    forward_search.spread_costs(blocked.ravel(), successors_or_self(12), STEPS_COST, start, 3.0, near)
    assert (near == np.where(whole <= 3.0, whole, np.inf)).all() and (whole > 3.0).any()
