import numpy as np

from zsdist.agent import shield
from zsdist.planning import forward_search, reachability
from zsdist.planning.belief import BeliefMap
from zsdist.planning.footprint import FootprintTable, successor
from zsdist.planning.grid import Grid
from zsdist.planning.reachability import BlockedMoves
from zsdist.planning.shortest_path import STEPS_COST, cost_to_go, goal_mask
from zsdist.types import Action, LatticeState

GRID = Grid()
EAST = LatticeState(16, 16, 0)
TURNS = [Action.TURN_LEFT_90, Action.TURN_RIGHT_90]


class MarkedBelief(BeliefMap):
    """Belief map whose cells are set as a test needs them."""

    def mark(self, cells, log_odds=2.4, seen=True):
        self._log_odds[cells], self._seen[cells] = log_odds, seen

    def forget(self, cells):
        self._seen[cells] = False


def known_free(occupied=None):
    """Return a belief map in which all ground was seen and is free except for the `occupied` fine cells."""
    belief = MarkedBelief(GRID)
    belief.clear_disc(0.0, 0.0, 20.0)
    if occupied is not None:
        belief.mark(occupied)
    return belief


def blob(ix, iy, half=3):
    squares = np.zeros((GRID.fine_size, GRID.fine_size), bool)
    fx, fy = GRID.fine_index(*GRID.centre(ix, iy))
    squares[fy - half : fy + half, fx - half : fx + half] = True
    return squares


def goals(ix, iy):
    return goal_mask(GRID, GRID.centre(ix, iy), 0.6)


def visited(*states):
    """Return the number of visits of each state, `(32, 32, 8)`."""
    visits = np.zeros((32, 32, 8), np.int32)
    for state in states:
        visits[state.iy, state.ix, state.heading] += 1
    return visits


def allowed(belief, state=EAST, goal=(28, 16)):
    judgement = shield.judge(belief, state, goals(*goal), visited(state))
    return judgement.allowed, judgement.gave_way


def test_open_and_seen_ground_allows_everything():
    mask, gave_way = allowed(known_free())
    assert mask.all() and not gave_way


def test_an_obstacle_ahead_masks_moving_on_but_not_turning():
    mask, gave_way = allowed(known_free(blob(19, 16)))
    assert not mask[Action.FORWARD] and mask[Action.TURN_LEFT_90] and mask[Action.TURN_RIGHT_90]
    assert not gave_way


def test_the_car_does_not_sweep_unseen_ground_while_there_is_another_way():
    belief = BeliefMap(GRID)
    x, y = GRID.centre(16, 16)
    belief.clear_disc(x, y, 1.5)
    for ahead in np.arange(0.0, 6.0, 0.3):
        belief.clear_disc(x + 1.0 + ahead, y, 0.9)
    belief.clear_disc(x + 6.0, y, 1.8)  # room in which the car could turn round
    mask, _ = allowed(belief)
    assert mask[Action.FORWARD] and not mask[Action.LEFT_45] and not mask[Action.RIGHT_45]


def pocket():
    """Return two walls 1.9 m apart that begin ahead of `EAST` and are closed at the far end, with no room to turn."""
    squares = np.zeros((GRID.fine_size, GRID.fine_size), bool)
    fx, fy = GRID.fine_index(*GRID.centre(20, 16))
    squares[fy - 9 : fy - 7, fx - 4 : fx + 20] = True
    squares[fy + 7 : fy + 9, fx - 4 : fx + 20] = True
    squares[fy - 9 : fy + 9, fx + 18 : fx + 20] = True
    return squares


def test_a_dead_end_without_room_to_turn_is_not_entered():
    state = LatticeState(18, 16, 0)
    judgement = shield.judge(known_free(pocket()), state, goals(28, 28), visited(state))
    assert not FootprintTable(GRID).blocked(pocket())[16, 18, 0, Action.FORWARD]
    assert judgement.moves.blocked[16, 18, 0, Action.FORWARD] and not judgement.allowed[Action.FORWARD]
    assert judgement.allowed.any()


def test_a_passage_too_narrow_to_turn_in_is_entered_only_once_its_end_was_seen():
    passage = pocket()
    fx, fy = GRID.fine_index(*GRID.centre(20, 16))
    passage[fy - 7 : fy + 7, fx + 18 : fx + 20] = False  # open at the far end
    state, end = LatticeState(18, 16, 0), slice(fx + 10, fx + 60)
    belief = known_free(passage)
    assert shield.judge(belief, state, goals(28, 16), visited(state)).allowed[Action.FORWARD]
    belief.forget((slice(fy - 40, fy + 40), end))  # its end is unseen, and there is a path around it
    judgement = shield.judge(belief, state, goals(28, 16), visited(state))
    assert not judgement.allowed[Action.FORWARD] and judgement.allowed.any()


def test_a_car_walled_in_by_a_narrow_belief_gets_a_smaller_margin_and_the_judgement_reports_it():
    ring = np.zeros((GRID.fine_size, GRID.fine_size), bool)
    fx, fy = GRID.fine_index(*GRID.centre(16, 16))
    ring[fy + 4 : fy + 6, fx - 12 : fx + 30] = True  # walls so near that only less than the usual margin passes
    ring[fy - 6 : fy - 4, fx - 12 : fx + 30] = True
    mask, gave_way = allowed(known_free(ring))
    assert mask[Action.FORWARD] and gave_way


def test_a_goal_believed_occupied_still_leaves_the_car_states_to_go_on_in():
    belief = known_free(blob(28, 16, half=8))
    mask, gave_way = allowed(belief)
    assert mask.all() and gave_way


def test_where_everything_is_blocked_only_turns_in_place_are_left():
    judgement = shield.judge(
        known_free(np.ones((GRID.fine_size, GRID.fine_size), bool)), EAST, goals(28, 16), visited(EAST)
    )
    assert judgement.forced and judgement.stuck
    assert list(np.flatnonzero(judgement.allowed)) == [Action.TURN_LEFT_90, Action.TURN_RIGHT_90]


def seen_disc_beyond_a_wall():
    """Return a belief map that knows only a disc around the car and a wall across the path to the goal."""
    belief = MarkedBelief(GRID)
    belief.clear_disc(*GRID.centre(16, 16), 1.5)
    wall = np.zeros((GRID.fine_size, GRID.fine_size), bool)
    fx, fy = GRID.fine_index(*GRID.centre(19, 16))
    wall[fy - 14 : fy + 14, fx : fx + 3] = True
    belief.mark(wall)
    return belief


def test_the_car_looks_in_all_directions_before_it_enters_unseen_ground():
    belief, been = seen_disc_beyond_a_wall(), [EAST]
    assert list(np.flatnonzero(shield.judge(belief, EAST, goals(28, 16), visited(*been)).allowed)) == TURNS
    been += [EAST._replace(heading=heading) for heading in (2, 4)]
    south = EAST._replace(heading=6)
    assert not shield.judge(belief, been[-1], goals(28, 16), visited(*been)).gave_way  # one observation is left
    judgement = shield.judge(belief, south, goals(28, 16), visited(*been, south))
    assert judgement.allowed.any() and judgement.gave_way


def test_a_state_not_yet_looked_from_may_lead_over_unseen_ground():
    belief = MarkedBelief(GRID)
    belief.clear_disc(*GRID.centre(16, 16), 1.5)
    judgement = shield.judge(belief, EAST, goals(28, 16), visited(EAST))
    assert judgement.moves.blocked[16, 16, 0, Action.FORWARD]
    assert not judgement.moves.blocked[16, 16, 2, Action.RIGHT_45] and not judgement.gave_way


def test_unseen_ground_counts_as_occupied_up_to_its_edge_except_for_slivers():
    belief = known_free()
    x, y = GRID.fine_index(*GRID.centre(16, 16))
    side = slice(y - 12, y - 5)  # the edge of this is 0.3 m beside the car
    for width, free in ((3, True), (12, False)):
        belief.clear_disc(0.0, 0.0, 20.0)
        belief.forget((side, slice(x + 4, x + 4 + width)))
        assert shield.judge(belief, EAST, goals(28, 28), visited(EAST)).allowed[Action.RIGHT_45] == free


def test_moves_off_the_grid_are_masked_for_everyone():
    assert list(shield.on_grid(LatticeState(31, 16, 0), 32)) == [False, False, False, True, True]
    assert shield.on_grid(EAST, 32).all()


def test_backward_reachability_agrees_with_the_cost_to_go_and_forward_reachability_with_driving():
    rng = np.random.default_rng(5)
    squares = np.zeros((GRID.fine_size, GRID.fine_size), bool)
    for fx, fy in rng.integers(20, 140, (20, 2)):
        squares[fy : fy + 6, fx : fx + 6] = True
    squares &= ~blob(16, 16, half=10)
    blocked = FootprintTable(GRID).blocked(squares)
    leading = reachability.unpack_states(
        BlockedMoves.from_array(blocked).states_reaching(reachability.pack_cells(goals(5, 5)))
    )
    assert (leading == np.isfinite(cost_to_go(blocked, goals(5, 5), STEPS_COST))).all()
    cells = np.isfinite(forward_search.path_lengths_from(blocked, EAST, STEPS_COST))
    state = EAST
    for action in rng.integers(0, 5, 400):
        if not blocked[state.iy, state.ix, state.heading, action]:
            state = successor(state, int(action))
            assert cells[state.iy, state.ix]
    assert cells.sum() > 100 and not cells[blob_cells(squares)].any()


def blob_cells(squares):
    """Return the cells whose centre lies in an occupied fine cell."""
    start = GRID.fine_border + 2
    return squares[start::4, start::4][:32, :32] & squares[start - 1 :: 4, start - 1 :: 4][:32, :32]


def test_the_shield_keeps_the_width_of_the_car_clear():
    for aside, free in ((3, False), (9, True)):
        fx, fy = GRID.fine_index(*GRID.centre(18, 16))
        squares = np.zeros((GRID.fine_size, GRID.fine_size), bool)
        squares[fy + aside, fx] = True
        blocked = shield.judge(known_free(squares), EAST, goals(28, 16), visited(EAST)).moves.blocked
        assert blocked[16, 16, 0, Action.FORWARD] != free
