import numpy as np
import pytest

from zsdist.planning import bitmaps, reachability
from zsdist.planning.footprint import FootprintTable, successor
from zsdist.planning.grid import Grid
from zsdist.planning.reachability import BlockedMoves
from zsdist.types import LatticeState

SIZES = [(6, 0.3), (12, 0.6), (12, 0.8), (64, 0.72), (70, 0.72), (130, 0.75)]


def world(cells, seed, share):
    """Return random blocked actions; those that end off the grid are always blocked."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((cells, cells, 8, 5)) < share
    for iy, ix, heading, action in np.ndindex(blocked.shape):
        end = successor(LatticeState(ix, iy, heading), action)
        blocked[iy, ix, heading, action] |= not (0 <= end.ix < cells and 0 <= end.iy < cells)
    return rng, blocked


def walked_to(blocked, targets):
    """Return the states with a path to a target cell, found one step at a time; `(cells, cells, 8)` bool."""
    cells = len(blocked)
    before = {}
    for iy, ix, heading, action in np.argwhere(~blocked).tolist():
        before.setdefault(successor(LatticeState(ix, iy, heading), action), []).append((iy, ix, heading))
    found = np.repeat(targets[:, :, None], 8, axis=2)
    queue = [tuple(state) for state in np.argwhere(found).tolist()]
    for iy, ix, heading in queue:
        for state in before.get(LatticeState(ix, iy, heading), ()):
            if not found[state]:
                found[state] = True
                queue.append(state)
    assert found.shape == (cells, cells, 8)
    return found


@pytest.mark.parametrize(("cells", "share"), SIZES)
def test_states_reaching_a_cell_are_those_from_which_single_steps_lead_there(cells, share):
    rng, blocked = world(cells, 5, share)
    targets = np.zeros((cells, cells), bool)
    targets[tuple(rng.integers(0, cells, (2, 3)))] = True
    reaching = reachability.unpack_states(
        BlockedMoves.from_array(blocked).states_reaching(reachability.pack_cells(targets))
    )
    assert 0.002 < reaching.mean() <= 1.0
    assert np.array_equal(reaching, walked_to(blocked, targets))


def test_a_cell_that_no_path_leads_to_is_reached_from_itself_only():
    targets = np.zeros((8, 8), bool)
    targets[3, 4] = True
    reaching = reachability.unpack_states(
        BlockedMoves.from_array(np.ones((8, 8, 8, 5), bool)).states_reaching(reachability.pack_cells(targets))
    )
    assert reaching[3, 4].all() and reaching.sum() == 8


@pytest.mark.parametrize(("cells", "share"), SIZES)
def test_blocking_exits_blocks_moves_that_end_outside_a_set_of_states(cells, share):
    rng, blocked = world(cells, 6, share)
    states = rng.random((cells, cells, 8)) < 0.5
    closed = BlockedMoves.from_array(blocked).blocking_exits_from(reachability.pack_states(states)).blocked
    assert (closed >= blocked).all()
    for iy, ix, heading, action in np.argwhere(~blocked)[::7].tolist():
        end = successor(LatticeState(ix, iy, heading), action)
        assert closed[iy, ix, heading, action] != states[end.iy, end.ix, end.heading]


@pytest.mark.parametrize("cells", [8, 64, 70])
def test_packing_loses_nothing(cells):
    rng, blocked = world(cells, 1, 0.5)
    made = BlockedMoves.from_array(blocked)
    assert np.array_equal(made.blocked, blocked)
    states = rng.random((cells, cells, 8)) < 0.5
    assert np.array_equal(reachability.unpack_states(reachability.pack_states(states)), states)
    for iy, ix, heading in rng.integers(0, (cells, cells, 8), (50, 3)).tolist():
        state = LatticeState(ix, iy, heading)
        assert np.array_equal(made.at_state(state), blocked[iy, ix, heading])
        assert reachability.contains_state(reachability.pack_states(states), state) == states[iy, ix, heading]


def test_where_takes_these_moves_in_some_states_and_the_others_in_the_rest():
    (rng, these), (_, others) = world(12, 1, 0.5), world(12, 2, 0.5)
    states = rng.random((12, 12, 8)) < 0.5
    mixed = (
        BlockedMoves.from_array(these).where(reachability.pack_states(states), BlockedMoves.from_array(others)).blocked
    )
    assert np.array_equal(mixed, np.where(states[..., None], these, others))


@pytest.mark.parametrize("cells", [8, 32, 100])
def test_blocked_moves_on_a_map_are_those_of_the_footprints(cells):
    grid = Grid(cells=cells, arena_m=cells * 0.625 + 5.0)
    occupied = np.random.default_rng(cells).random((grid.fine_size, grid.fine_size)) < 0.003
    table = FootprintTable(grid)
    on = BlockedMoves.from_occupancy(bitmaps.pack_rows(occupied), table)
    assert np.array_equal(on.blocked, table.blocked(occupied)) and not on.blocked.all()
    assert np.array_equal(on.words, BlockedMoves.from_array(on.blocked).words), "bits beyond the last cell are set"
