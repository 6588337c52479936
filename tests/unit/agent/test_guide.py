import numpy as np

from zsdist.agent import guide, reward_shaping
from zsdist.agent.blocks import GOAL_CHOICE, choices
from zsdist.agent.situation import Situation, Tries
from zsdist.config import AgentConfig
from zsdist.planning import forward_search
from zsdist.planning.footprint import FootprintTable
from zsdist.planning.grid import Grid
from zsdist.planning.reachability import BlockedMoves
from zsdist.planning.shortest_path import cost_to_go, goal_mask
from zsdist.types import Action, LatticeState

GRID = Grid()
TABLE = FootprintTable(GRID)
EVERY = np.ones(5, bool)
EAST = LatticeState(12, 12, 0)


def situation(occupied=None, state=EAST, goal=(8.0, -1.9), seen=True, advice=(0.0, 1.0, -1.0), visited=1):
    size = GRID.fine_size
    occupied = np.zeros((size, size), bool) if occupied is None else occupied
    visits = np.zeros((32, 32, 8), np.int32)
    visits[state.iy, state.ix, state.heading] = visited
    blocked = TABLE.blocked(occupied)
    return Situation(
        grid=GRID,
        state=state,
        goal=goal,
        advice=np.array(advice, np.float32),
        occupied=occupied,
        seen=np.full((size, size), seen),
        moves=BlockedMoves.from_array(blocked),
        gave_way=False,
        goals=goal_mask(GRID, goal, 0.6),
        drive_m=forward_search.path_lengths_from(blocked, state, reward_shaping.path_costs(GRID)),
        visits=visits,
        block_visits=np.zeros((4, 4), np.int32),
        tries=Tries.none(GRID),
    )


def test_advice_guides_in_an_explored_block_and_the_field_in_an_unexplored_one():
    ahead = GRID.centre(20, 12)
    low = guide.LowGuide(AgentConfig())
    assert low.action(situation(), ahead, EVERY) is Action.LEFT_45
    assert low.action(situation(seen=False), ahead, EVERY) is Action.FORWARD
    assert (low.explored, low.unexplored) == (1, 1)


def test_advice_is_not_followed_twice_in_a_state_nor_away_from_the_subgoal():
    low = guide.LowGuide(AgentConfig())
    assert low.action(situation(visited=2), GRID.centre(20, 12), EVERY) is not Action.LEFT_45
    assert low.action(situation(), GRID.centre(14, 4), EVERY) is not Action.LEFT_45
    assert low.explored == 0


def test_the_guide_never_returns_a_masked_action():
    low = guide.LowGuide(AgentConfig())
    for action in Action:
        mask = np.arange(5) == action
        assert low.action(situation(), GRID.centre(20, 12), mask) is action
    assert low.action(situation(), GRID.centre(20, 12), np.zeros(5, bool)) is None


def test_explored_share_counts_the_seen_cells_of_a_block():
    known = situation(seen=False)
    border, side = GRID.fine_border, GRID.block_size * 4
    known.seen[border + side : border + 2 * side, border : border + side // 2] = True
    assert guide.explored_share(known, 0, 1) == 0.5
    assert guide.explored_share(known, 1, 1) == 0.0


def choose(known):
    costs = reward_shaping.path_costs(GRID)
    field = cost_to_go(known.blocked, goal_mask(GRID, known.goal, 0.6), costs)
    return guide.high_choice(known, choices(known), field, costs)


def test_the_planner_chooses_the_goal_where_the_way_is_about_straight_and_else_the_next_block():
    assert choose(situation(goal=GRID.centre(30, 12))) == GOAL_CHOICE
    wall = np.zeros((GRID.fine_size, GRID.fine_size), bool)
    x, y = GRID.fine_index(*GRID.centre(26, 12))
    wall[y - 30 : y + 30, x : x + 3] = True  # the path around it is long, and begins straight ahead
    assert choose(situation(wall, goal=GRID.centre(30, 12))) in (0, 1, 7)


def test_the_planner_goes_round_a_wall():
    wall = np.zeros((GRID.fine_size, GRID.fine_size), bool)
    x, y = GRID.fine_index(*GRID.centre(16, 12))
    wall[y - 40 : y + 12, x : x + 3] = True  # open to the north only
    known = situation(wall, goal=GRID.centre(30, 12), state=LatticeState(12, 12, 0))
    assert choose(known) in (1, 2)  # to the left


def test_the_planner_chooses_the_goal_where_it_is_walled_in():
    walls = np.zeros((GRID.fine_size, GRID.fine_size), bool)
    x, y = GRID.fine_index(*GRID.centre(28, 12))
    walls[y - 10 : y + 10, x - 10 : x + 10] = True
    assert choose(situation(walls, goal=GRID.centre(28, 12))) == GOAL_CHOICE
