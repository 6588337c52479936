import numpy as np
import pytest

from zsdist.planning import bitmaps, reachability
from zsdist.planning.footprint import FootprintTable, successor
from zsdist.planning.grid import Grid
from zsdist.planning.reachability import BlockedMoves
from zsdist.types import LatticeState

SIZES = [(6, 0.3), (12, 0.6), (12, 0.8), (64, 0.72), (70, 0.72), (130, 0.75)]


def world(cells, seed, share):
    """Random blocked actions; those that end off the grid always are."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((cells, cells, 8, 5)) < share
    for iy, ix, heading, action in np.ndindex(blocked.shape):
        end = successor(LatticeState(ix, iy, heading), action)
        blocked[iy, ix, heading, action] |= not (0 <= end.ix < cells and 0 <= end.iy < cells)
    return rng, blocked


def walked_to(blocked, places):
    """States from which a way leads to one of the places, one step at a time; `(cells, cells, 8)` bool."""
    cells = len(blocked)
    before = {}
    for iy, ix, heading, action in np.argwhere(~blocked).tolist():
        before.setdefault(successor(LatticeState(ix, iy, heading), action), []).append((iy, ix, heading))
    found = np.repeat(places[:, :, None], 8, axis=2)
    queue = [tuple(state) for state in np.argwhere(found).tolist()]
    for iy, ix, heading in queue:
        for state in before.get(LatticeState(ix, iy, heading), ()):
            if not found[state]:
                found[state] = True
                queue.append(state)
    assert found.shape == (cells, cells, 8)
    return found


@pytest.mark.parametrize(("cells", "share"), SIZES)
def test_states_to_a_place_are_those_from_which_walking_comes_there(cells, share):
    rng, blocked = world(cells, 5, share)
    places = np.zeros((cells, cells), bool)
    places[tuple(rng.integers(0, cells, (2, 3)))] = True
    leading = reachability.unpacked(BlockedMoves.of(blocked).states_to(reachability.packed_cells(places)))
    assert 0.002 < leading.mean() <= 1.0
    assert np.array_equal(leading, walked_to(blocked, places))


def test_a_place_that_nothing_leads_to_is_reached_from_itself_only():
    places = np.zeros((8, 8), bool)
    places[3, 4] = True
    leading = reachability.unpacked(
        BlockedMoves.of(np.ones((8, 8, 8, 5), bool)).states_to(reachability.packed_cells(places))
    )
    assert leading[3, 4].all() and leading.sum() == 8


@pytest.mark.parametrize(("cells", "share"), SIZES)
def test_leaving_blocks_what_ends_outside_a_set_of_states(cells, share):
    rng, blocked = world(cells, 6, share)
    states = rng.random((cells, cells, 8)) < 0.5
    left = BlockedMoves.of(blocked).leaving(reachability.packed_states(states)).blocked
    assert (left >= blocked).all()
    for iy, ix, heading, action in np.argwhere(~blocked)[::7].tolist():
        end = successor(LatticeState(ix, iy, heading), action)
        assert left[iy, ix, heading, action] != states[end.iy, end.ix, end.heading]


@pytest.mark.parametrize("cells", [8, 64, 70])
def test_bits_give_back_what_they_were_made_of(cells):
    rng, blocked = world(cells, 1, 0.5)
    made = BlockedMoves.of(blocked)
    assert np.array_equal(made.blocked, blocked)
    states = rng.random((cells, cells, 8)) < 0.5
    assert np.array_equal(reachability.unpacked(reachability.packed_states(states)), states)
    for iy, ix, heading in rng.integers(0, (cells, cells, 8), (50, 3)).tolist():
        state = LatticeState(ix, iy, heading)
        assert np.array_equal(made.at(state), blocked[iy, ix, heading])
        assert reachability.contains(reachability.packed_states(states), state) == states[iy, ix, heading]


def test_among_takes_these_ways_of_some_states_and_the_others_of_the_rest():
    (rng, these), (_, others) = world(12, 1, 0.5), world(12, 2, 0.5)
    states = rng.random((12, 12, 8)) < 0.5
    mixed = BlockedMoves.of(these).among(reachability.packed_states(states), BlockedMoves.of(others)).blocked
    assert np.array_equal(mixed, np.where(states[..., None], these, others))


@pytest.mark.parametrize("cells", [8, 32, 100])
def test_ways_on_a_map_are_those_of_the_footprints(cells):
    grid = Grid(cells=cells, arena_m=cells * 0.625 + 5.0)
    occupied = np.random.default_rng(cells).random((grid.fine_size, grid.fine_size)) < 0.003
    table = FootprintTable(grid)
    on = BlockedMoves.on(bitmaps.packed_rows(occupied), table)
    assert np.array_equal(on.blocked, table.blocked(occupied)) and not on.blocked.all()
    assert np.array_equal(on.words, BlockedMoves.of(on.blocked).words), "what lies beyond the last cell is blocked"
