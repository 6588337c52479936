"""Planner on the believed map of one episode: shortest paths to the goal and to the subgoal of the present option."""

import math

import numpy as np

from zsdist.agent import guide
from zsdist.agent.blocks import Choices
from zsdist.agent.options import Option
from zsdist.agent.reward_shaping import path_costs
from zsdist.agent.situation import Situation
from zsdist.planning.cost_field import CostField
from zsdist.planning.footprint import successor
from zsdist.planning.grid import Grid
from zsdist.types import Action


class Planner:
    """Costs to go on the believed map of one episode, kept up to date while the map changes.

    Args:
        grid: planning grid.
        goals: `(cells, cells)` bool, the cells in which the goal is reached.
    """

    def __init__(self, grid: Grid, goals: np.ndarray) -> None:
        self._grid, self._costs = grid, path_costs(grid)
        self._goal_field = CostField(goals, self._costs)
        self._subgoal_field: CostField | None = None

    def cost_to_goal(self, situation: Situation) -> np.ndarray:
        """Return the metres from every state to the goal on the believed map, `(cells, cells, 8)`."""
        return self._goal_field.costs_on(situation.blocked)

    def cost_to_subgoal(self, situation: Situation, option: Option) -> np.ndarray:
        """Return the metres from every state to an option's subgoal on the believed map, `(cells, cells, 8)`."""
        if option.seeks_goal:
            return self.cost_to_goal(situation)
        ix, iy = self._grid.cell_at(*option.subgoal)
        if self._subgoal_field is None or not self._subgoal_field.targets[iy, ix]:
            targets = np.zeros((self._grid.cells, self._grid.cells), bool)
            targets[iy, ix] = True
            self._subgoal_field = CostField(targets, self._costs)
        return self._subgoal_field.costs_on(situation.blocked)

    def high_choice(self, situation: Situation, options: Choices) -> int:
        """Return the next choice on the shortest believed path to the goal, as `guide.high_choice` does."""
        return guide.high_choice(situation, options, self.cost_to_goal(situation), self._costs)

    def low_action(
        self, situation: Situation, option: Option, allowed: np.ndarray, otherwise: Action | None
    ) -> Action | None:
        """Return the first action of the shortest believed path to an option's subgoal.

        Args:
            situation: knowledge of the car.
            option: option with the subgoal.
            allowed: `(5,)` bool, actions to choose among.
            otherwise: action to return where no path leads to the subgoal.
        """
        state, is_allowed = situation.state, allowed.tolist()
        cost, steps = self.cost_to_subgoal(situation, option), self._costs[state.heading].tolist()
        least, best = math.inf, otherwise
        for action in Action:
            end = successor(state, action)
            if is_allowed[action] and self._grid.on_grid(end.ix, end.iy):
                total = float(cost[end.iy, end.ix, end.heading]) + steps[action]
                if total < least:
                    least, best = total, action
        return best
