import heapq

import numpy as np
import pytest

from zsdist.planning.footprint import FootprintTable, successor
from zsdist.planning.grid import Grid
from zsdist.planning.shortest_path import (
    METRES,
    STEPS_COST,
    cost_to_go,
    goal_mask,
    length_m,
    path,
    viable_states,
)
from zsdist.types import Action, LatticeState

GRID = Grid()
TABLE = FootprintTable(GRID)
GOAL = GRID.centre(28, 16)
GOALS = goal_mask(GRID, GOAL, 0.60)


@pytest.fixture(scope="module")
def blocked():
    occupancy = np.zeros((160, 160), dtype=bool)
    rng = np.random.default_rng(5)
    for fx, fy in rng.integers(20, 140, (22, 2)):
        occupancy[fy : fy + 9, fx : fx + 9] = True
    occupancy[70:95, 122:142] = False
    return TABLE.blocked(occupancy)


def dijkstra_in_python(blocked, costs, goal_cells):
    """Return the same costs, computed over explicit edges with the standard library's heap."""
    cells, edges = len(blocked), {}
    for iy, ix, heading, action in np.argwhere(~blocked):
        start = LatticeState(int(ix), int(iy), int(heading))
        edges.setdefault(successor(start, action), []).append((start, costs[heading, action]))
    best = {LatticeState(ix, iy, h): 0.0 for iy, ix in goal_cells for h in range(8)}
    queue = [(0.0, state) for state in best]
    heapq.heapify(queue)
    while queue:
        cost, state = heapq.heappop(queue)
        if cost > best[state]:
            continue
        for before, extra in edges.get(state, ()):
            if cost + extra < best.get(before, np.inf):
                best[before] = cost + extra
                heapq.heappush(queue, (cost + extra, before))
    field = np.full((cells, cells, 8), np.inf)
    for state, cost in best.items():
        field[state.iy, state.ix, state.heading] = cost
    return field


@pytest.mark.parametrize("costs", [METRES, STEPS_COST], ids=["metres", "steps"])
def test_costs_equal_those_of_an_independent_search(blocked, costs):
    field = cost_to_go(blocked, GOALS, costs)
    want = dijkstra_in_python(blocked, costs, np.argwhere(GOALS))
    assert field.dtype == np.float32 and field.shape == (32, 32, 8)
    assert 0.2 < np.isfinite(field).mean() < 0.95
    np.testing.assert_allclose(field, want, rtol=1e-5)


def test_following_the_field_reaches_the_goal_by_unblocked_actions_at_the_promised_cost(blocked):
    field = cost_to_go(blocked, GOALS, METRES)
    starts = np.argwhere(np.isfinite(field))
    for iy, ix, heading in starts[:: max(1, len(starts) // 40)]:
        way = path(field, blocked, LatticeState(int(ix), int(iy), int(heading)), METRES)
        assert GOALS[way.states[-1].iy, way.states[-1].ix]
        total = 0.0
        for state, action, end in zip(way.states, way.actions, way.states[1:], strict=False):
            assert not blocked[state.iy, state.ix, state.heading, action]
            assert successor(state, action) == end
            total += METRES[state.heading, action]
        assert total == pytest.approx(field[iy, ix, heading], rel=1e-4, abs=1e-6)


def test_in_an_empty_arena_the_path_straight_ahead_costs_its_length_in_metres_and_steps():
    free = TABLE.blocked(np.zeros((160, 160), dtype=bool))
    start = LatticeState(8, 16, 0)
    way = path(cost_to_go(free, GOALS, METRES), free, start, METRES)
    assert way.actions == [Action.FORWARD] * 20
    assert length_m(way.states, GRID.cell_size_m) == 12.5
    assert cost_to_go(free, GOALS, STEPS_COST)[16, 8, 0] == 20


def test_a_car_that_faces_away_turns_before_it_drives():
    free = TABLE.blocked(np.zeros((160, 160), dtype=bool))
    way = path(cost_to_go(free, GOALS, METRES), free, LatticeState(20, 16, 4), METRES)
    assert len([action for action in way.actions if action >= Action.TURN_LEFT_90]) == 2
    assert length_m(way.states, GRID.cell_size_m) == 5.0


def test_without_a_path_the_cost_is_infinite_and_asking_for_the_path_is_an_error(blocked):
    nothing = np.ones_like(blocked)
    field = cost_to_go(nothing, GOALS, METRES)
    assert np.isinf(field[~GOALS]).all() and (field[GOALS] == 0).all()
    with pytest.raises(ValueError, match="no path leads"):
        path(field, nothing, LatticeState(1, 1, 0), METRES)


def test_costs_of_another_map_are_refused_instead_of_looping(blocked):
    free = TABLE.blocked(np.zeros((160, 160), dtype=bool))
    field = cost_to_go(free, GOALS, METRES)
    with pytest.raises(ValueError, match="another map"):
        path(field, np.ones_like(blocked), LatticeState(1, 1, 0), METRES)


def test_an_action_that_costs_nothing_is_refused(blocked):
    with pytest.raises(ValueError, match="above 0"):
        cost_to_go(blocked, GOALS, np.zeros((8, 5)))


def test_goal_cells_are_those_whose_centre_is_within_the_success_radius():
    assert np.argwhere(goal_mask(GRID, GRID.centre(3, 4), 0.60)).tolist() == [[4, 3]]
    assert goal_mask(GRID, (0.0, 0.0), 0.60).sum() == 4


def test_viable_states_are_the_largest_set_that_the_car_can_stay_in(blocked):
    viable = viable_states(blocked)
    free = np.argwhere(~blocked)
    ends = np.array([successor(LatticeState(ix, iy, heading), action) for iy, ix, heading, action in free])
    expected = ~blocked.all(axis=3)
    while True:  # the definition, step by step
        following = np.zeros_like(expected)
        stays = expected[ends[:, 1], ends[:, 0], ends[:, 2]]
        following[tuple(free[stays, :3].T)] = True
        if (following == expected).all():
            break
        expected = following
    assert (viable == expected).all()


def test_a_dead_end_too_narrow_to_turn_in_is_free_but_not_viable():
    occupancy = np.zeros((160, 160), dtype=bool)
    row = GRID.fine_border + 4 * 16 + 2  # a slot 1.56 m wide that ends at column 26, open to the west
    occupancy[row - 9 : row - 5, 60:130] = True
    occupancy[row + 5 : row + 9, 60:130] = True
    occupancy[row - 9 : row + 9, 126:130] = True
    blocked = TABLE.blocked(occupancy)
    viable = viable_states(blocked)
    assert not blocked[16, 20, 0, Action.FORWARD]
    assert not viable[16, 20, 0] and not viable[16, 22, 0]
    assert viable[16, 20, 4], "facing the mouth it drives out"
