"""Guide policies of exploration: the global policy of Algorithm 2 (low level), and a planner over blocks (high level).

Both serve training. A contender with one of them in place of a network is another variant than `full`.
"""

import math

import numpy as np

from zsdist.agent.blocks import GOAL_CHOICE, Choices
from zsdist.agent.situation import Situation
from zsdist.common.compiled import compiled
from zsdist.config import AgentConfig
from zsdist.planning import policy_map, potential
from zsdist.planning.footprint import ACTIONS, successor
from zsdist.planning.grid import HEADINGS
from zsdist.planning.shortest_path import flat_path
from zsdist.types import Action

DIRECT_RATIO, DIRECT_M = 1.1, 1.0  # a path of at most RATIO times the straight line plus M needs no block as subgoal
_MOST_TRAIL = 5  # largest number of a cell's visits that counts
_RELUCTANCE = 0.5  # times the trail's weight: loss of an action's cosine for each visit of its end state


class LowGuide:
    """Global policy, the union of advice and potential field, under the shield's mask."""

    def __init__(self, config: AgentConfig) -> None:
        self._config = config
        self._pool = policy_map.PolicyMap()
        self.explored, self.unexplored = 0, 0  # number of guide actions from advice and from the field

    def action(self, situation: Situation, subgoal: tuple[float, float], mask: np.ndarray) -> Action | None:
        """Return the action of the global policy; None where nothing is allowed.

        The advice decides in explored blocks, the first time that the car is in a state. If the car returns to a state,
        the advice has led it in a circle, and the potential field with its trail decides. The field also decides where
        the advice, which knows the goal and not the subgoal, leads away from the subgoal.

        Args:
            situation: knowledge of the car.
            subgoal: `(x_m, y_m)` of the subgoal.
            mask: `(5,)` bool, allowed actions.
        """
        state = situation.state
        first = situation.visits[state.iy, state.ix, state.heading] <= 1
        advised = policy_map.advised_action(situation.advice, mask)
        if advised is not None:
            self._pool.add(state, advised)
        serves = advised is not None and _towards(situation, subgoal, advised)
        action, from_pool = self._pool.overall(
            state,
            first and serves and self._block_explored(situation),
            lambda: self.descend(situation, subgoal, mask),
        )
        if from_pool:
            self.explored += 1
        elif action is not None:
            self.unexplored += 1
        return action

    def _block_explored(self, situation: Situation) -> bool:
        return explored_share(situation, *situation.block) >= self._config.explored_share

    def descend(self, situation: Situation, target: tuple[float, float], mask: np.ndarray) -> Action | None:
        """Return the action of the potential field with its trail; None where nothing is allowed."""
        config, state = self._config, situation.state
        direction = potential.force(
            situation.position,
            target,
            _surfaces(situation, config.influence_m + potential.BODY_M),
            k_att=config.attraction,
            k_rep=config.repulsion,
            influence_m=config.influence_m,
            trail=_trail(situation),
            k_trail=config.trail,
        )
        ends = [successor(state, action) for action in range(ACTIONS)]
        cells = situation.grid.cells
        visited = [
            situation.visits[end.iy, end.ix, end.heading] if situation.grid.on_grid(end.ix, end.iy) else cells
            for end in ends
        ]
        reluctance = _RELUCTANCE * config.trail * np.array(visited, float)
        return potential.action_along(direction, state.heading * math.pi / 4, mask, reluctance)


def high_choice(situation: Situation, options: Choices, cost_to_goal: np.ndarray, action_costs: np.ndarray) -> int:
    """Return the choice of the next block on the shortest believed path to the goal, or of the goal itself.

    The goal is chosen where no path leads there, and where the path is hardly longer than the straight line, since a
    subgoal in a block would only bend it.

    Args:
        situation: knowledge of the car.
        options: choices of the high level.
        cost_to_goal: `(cells, cells, 8)` cost to go in metres, on the believed map.
        action_costs: `(8, 5)` metres by heading and action, from which it was computed.
    """
    state = situation.state
    way_m = float(cost_to_goal[state.iy, state.ix, state.heading])
    if not math.isfinite(way_m) or way_m <= DIRECT_RATIO * math.dist(situation.position, situation.goal) + DIRECT_M:
        return GOAL_CHOICE
    grid = situation.grid
    goal_block = tuple(options.blocks[GOAL_CHOICE])
    cells = flat_path(cost_to_goal, situation.blocked, state, action_costs)[0] // HEADINGS
    on_the_way = ((cell % grid.cells, cell // grid.cells) for cell in cells.tolist())
    blocks = (grid.block_of(ix, iy) for ix, iy in on_the_way)
    block = next((block for block in blocks if block != situation.block), None)
    if block is None:
        return GOAL_CHOICE
    index = options.index_of(block)
    return GOAL_CHOICE if block == goal_block or index is None or not options.mask[index] else index


def explored_share(situation: Situation, bx: int, by: int) -> float:
    """Return the share of a block's cells whose centre has been seen."""
    grid = situation.grid
    start, step = grid.fine_border + 2, 4
    centres = situation.seen[start::step, start::step][: grid.cells, : grid.cells]
    block = centres[grid.block_cells(bx, by)]
    return np.count_nonzero(block) / block.size


def _towards(situation: Situation, subgoal: tuple[float, float], action: Action) -> bool:
    (x, y), end = situation.position, successor(situation.state, action)
    heading = end.heading * math.pi / 4
    return (subgoal[0] - x) * math.cos(heading) + (subgoal[1] - y) * math.sin(heading) > 0


def _surfaces(situation: Situation, reach_m: float) -> np.ndarray:
    """Return the centres of occupied fine cells within about `reach_m` of the car, `(N, 2)` metres."""
    grid, (x, y) = situation.grid, situation.position
    fx, fy = grid.fine_index(x, y)
    reach = math.ceil(reach_m / grid.fine_m)
    top, left = max(fy - reach, 0), max(fx - reach, 0)
    near = situation.occupied[top : fy + reach + 1, left : fx + reach + 1]
    west, south = (at * grid.fine_m - grid.arena_m / 2 for at in (left + 0.5, top + 0.5))
    return _set_cell_centres(near, west, south, grid.fine_m)


def _trail(situation: Situation) -> np.ndarray:
    """Return the centres of visited cells, `(M, 2)` metres, each repeated once per visit.

    The present cell is included; at distance 0 it exerts no force.
    """
    grid = situation.grid
    return _visited_centres(situation.visits, grid.cell_size_m, grid.side_m / 2)


@compiled()
def _set_cell_centres(flags: np.ndarray, west: float, south: float, side: float) -> np.ndarray:
    """Return the centres of the fine cells that are set, `(N, 2)` metres.

    Args:
        flags: `(rows, columns)` bool.
        west: x of the first column's centres, metres.
        south: y of the first row's centres, metres.
        side: side of a fine cell, metres.
    """
    centres, count = np.empty((flags.size, 2)), 0
    for row in range(flags.shape[0]):
        for column in range(flags.shape[1]):
            if flags[row, column]:
                centres[count, 0], centres[count, 1] = column * side + west, row * side + south
                count += 1
    return centres[:count]


@compiled()
def _visited_centres(visits: np.ndarray, cell: float, half: float) -> np.ndarray:
    """Return the centres of visited cells, `(M, 2)` metres, each once per visit, at most `_MOST_TRAIL` times.

    Args:
        visits: `(cells, cells, 8)` int, number of visits of each state.
        cell: side of a cell, metres.
        half: half the side of the grid, metres.
    """
    centres, count = np.empty((_MOST_TRAIL * visits.shape[0] * visits.shape[1], 2)), 0
    for row in range(visits.shape[0]):
        for column in range(visits.shape[1]):
            for _ in range(min(visits[row, column].sum(), _MOST_TRAIL)):
                centres[count, 0], centres[count, 1] = (column + 0.5) * cell - half, (row + 0.5) * cell - half
                count += 1
    return centres[:count]
