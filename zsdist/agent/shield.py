"""The shield: masks what would hit believed-occupied space or end where no free way leads on. It never chooses."""

import numpy as np

from zsdist.agent import reach
from zsdist.planning.footprint import ACTIONS, successor
from zsdist.planning.shortest_path import live_states
from zsdist.types import Action, LatticeState

_IN_PLACE = (Action.TURN_LEFT_90, Action.TURN_RIGHT_90)


def live(blocked: np.ndarray, state: LatticeState, goals: np.ndarray) -> np.ndarray:
    """States with a believed-safe way on, `(cells, cells, 8)` bool.

    Those from which the goal can be reached through space not believed occupied; where the car itself is not one of
    them (the map may be wrong about the goal), those from which it can keep going.
    """
    leading = reach.states_to(blocked, goals)
    return leading if leading[state.iy, state.ix, state.heading] else live_states(blocked)


def on_grid(state: LatticeState, cells: int) -> np.ndarray:
    """Actions that do not leave the grid, `(5,)` bool: masked for every policy."""
    ends = (successor(state, action) for action in range(ACTIONS))
    return np.array([0 <= end.ix < cells and 0 <= end.iy < cells for end in ends])


def mask(blocked: np.ndarray, live: np.ndarray, state: LatticeState) -> tuple[np.ndarray, bool]:
    """Actions that the shield allows, `(5,)` bool, and whether it had to give way.

    Where no action passes, those that are not blocked; then turns in place; the caller counts how often.
    """
    free = ~blocked[state.iy, state.ix, state.heading]
    ends = [successor(state, action) for action in range(ACTIONS)]
    safe = np.array([ok and live[end.iy, end.ix, end.heading] for ok, end in zip(free, ends, strict=True)])
    if safe.any():
        return safe, False
    if free.any():
        return free, True
    turns = np.zeros(ACTIONS, bool)
    turns[list(_IN_PLACE)] = True
    return turns, True
