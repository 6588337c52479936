import heapq

import numpy as np
import pytest

from zsdist.agent.reward_shaping import path_costs
from zsdist.planning.cost_field import CostField
from zsdist.planning.footprint import successor
from zsdist.planning.grid import Grid
from zsdist.planning.lattice import NOWHERE, predecessors
from zsdist.planning.shortest_path import METRES, STEPS_COST
from zsdist.types import LatticeState

CELLS = 12


def world(rng, share):
    """Return random blocked actions; those that end off the grid are always blocked."""
    blocked = rng.random((CELLS, CELLS, 8, 5)) < share
    for iy, ix, heading, action in np.ndindex(blocked.shape):
        end = successor(LatticeState(ix, iy, heading), action)
        blocked[iy, ix, heading, action] |= not (0 <= end.ix < CELLS and 0 <= end.iy < CELLS)
    return blocked


def targets(*cells):
    mask = np.zeros((CELLS, CELLS), bool)
    for ix, iy in cells:
        mask[iy, ix] = True
    return mask


def searched(blocked, targets, costs):
    """Return the costs by Dijkstra's algorithm from the targets, against the direction of travel."""
    flat, before = blocked.reshape(-1, 5), predecessors(CELLS).tolist()
    cost = np.where(np.repeat(targets.ravel(), 8), 0.0, np.inf).tolist()
    queue = [(0.0, state) for state, value in enumerate(cost) if value == 0.0]
    while queue:
        so_far, state = heapq.heappop(queue)
        if so_far > cost[state]:
            continue
        for action, previous in enumerate(before[state]):
            if previous != NOWHERE and not flat[previous, action]:
                total = so_far + costs[previous % 8, action]
                if total < cost[previous]:
                    cost[previous] = total
                    heapq.heappush(queue, (total, previous))
    return np.array(cost, np.float32).reshape(CELLS, CELLS, 8)


@pytest.mark.parametrize("costs", [STEPS_COST, METRES, path_costs(Grid(cells=CELLS, blocks=3))])
def test_costs_repaired_from_map_to_map_are_bit_identical_to_those_of_a_new_search(costs):
    rng = np.random.default_rng(0)
    field, closed = CostField(targets((3, 9), (4, 9)), costs), 0
    for step in range(120):
        other = world(rng, rng.choice([0.2, 0.5, 0.8]))
        if step:
            changed = rng.random(other.shape) < rng.choice([1e-3, 0.02, 0.3, 1.0])
            other = np.where(changed, other, blocked)  # noqa: F821 - of the step before
        blocked = other
        expected = searched(blocked, field.targets, costs)
        assert np.array_equal(field.costs_on(blocked), expected)
        closed += int(np.isinf(expected).sum())
    assert closed


def test_a_path_that_closes_and_opens_again_costs_what_it_did():
    free = world(np.random.default_rng(0), 0.0)
    field = CostField(targets((9, 5)), METRES)
    before = field.costs_on(free).copy()
    walled = free.copy()
    walled[:, 6] = True
    assert np.isinf(field.costs_on(walled)[5, 2]).all()
    assert np.array_equal(field.costs_on(free), before)


def test_the_same_map_gives_the_same_costs_without_a_search():
    free = world(np.random.default_rng(0), 0.0)
    field = CostField(targets((9, 5)), METRES)
    assert field.costs_on(free) is field.costs_on(free)
    assert field.costs_on(free) is field.costs_on(free.copy())
