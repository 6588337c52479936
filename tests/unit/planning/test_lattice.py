import numpy as np

from zsdist.planning.footprint import successor
from zsdist.planning.lattice import NOWHERE, flat_state, lattice_state, predecessors, successors
from zsdist.types import LatticeState

CELLS = 7


def test_flat_states_follow_the_order_of_arrays_and_convert_back():
    order = np.arange(CELLS * CELLS * 8).reshape(CELLS, CELLS, 8)
    for state in (LatticeState(0, 0, 0), LatticeState(3, 5, 6), LatticeState(6, 6, 7)):
        assert flat_state(state, CELLS) == order[state.iy, state.ix, state.heading]
        assert lattice_state(flat_state(state, CELLS), CELLS) == state


def test_successors_are_where_actions_end_and_nowhere_off_the_grid():
    table = successors(CELLS)
    for flat, ends in enumerate(table):
        for action, found in enumerate(ends):
            end = successor(lattice_state(flat, CELLS), action)
            inside = 0 <= end.ix < CELLS and 0 <= end.iy < CELLS
            assert found == (flat_state(end, CELLS) if inside else NOWHERE)


def test_predecessors_are_the_states_whose_successor_is_here():
    after, before = successors(CELLS), predecessors(CELLS)
    forwards = {(state, action, int(end)) for state, ends in enumerate(after) for action, end in enumerate(ends)}
    backwards = {(int(state), action, end) for end, states in enumerate(before) for action, state in enumerate(states)}
    assert {edge for edge in forwards if edge[2] != NOWHERE} == {edge for edge in backwards if edge[0] != NOWHERE}


def test_the_tables_are_shared_and_cannot_be_written():
    assert successors(CELLS) is successors(CELLS)
    assert not successors(CELLS).flags.writeable and not predecessors(CELLS).flags.writeable
