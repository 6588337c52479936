"""Cost to go to one target, repaired when the map changes. One view changes few moves, so no search is repeated.

A move is a pair of state and action; its number is `ACTIONS * state + action`.
"""

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.footprint import ACTIONS
from zsdist.planning.grid import HEADINGS
from zsdist.planning.lattice import predecessors_or_self, successors_or_self


class CostField:
    """Cost to go from every state to one target, on one map after another.

    Args:
        targets: `[iy, ix]` `(cells, cells)` bool, cells of the target.
        action_costs: `(8, 5)`, by heading before the action, above 0.

    Attributes:
        targets: cells of the target, `[iy, ix]` `(cells, cells)` bool.
    """

    def __init__(self, targets: np.ndarray, action_costs: np.ndarray) -> None:
        self.targets = targets
        self._action_costs = np.asarray(action_costs, dtype=np.float64)
        self._blocked: np.ndarray | None = None  # blocked moves of the last map
        self._cost: np.ndarray  # least costs on the last map, float32
        self._exact = np.where(np.repeat(targets.ravel(), HEADINGS), 0.0, np.inf)

    def costs_on(self, blocked: np.ndarray) -> np.ndarray:
        """Return the least cost from every state to the target on a map.

        Args:
            blocked: `(cells, cells, 8, 5)` bool, blocked moves; contiguous; must not change before the next call.

        Returns:
            `[iy, ix, heading]` `(cells, cells, 8)` float32; infinite where no path leads to the target.
        """
        if blocked is self._blocked:
            return self._cost
        cells, new = len(blocked), blocked.ravel()
        if self._blocked is None:  # as if everything had been blocked before; only moves into a target matter then
            changed = _moves_into(self.targets.ravel(), predecessors_or_self(cells))
        else:
            old = self._blocked.ravel()
            changed = _changed_moves(old.view(np.uint64), new.view(np.uint64), old, new)
        if self._blocked is None or len(changed):
            before, after = predecessors_or_self(cells), successors_or_self(cells)
            _repair(self._exact, new, changed, self._action_costs, before, after)
            self._cost = self._exact.astype(np.float32).reshape(cells, cells, HEADINGS)
        self._blocked = blocked
        return self._cost


@compiled()
def _moves_into(targets: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the moves that end in a target; `before` is the table `lattice.predecessors_or_self`."""
    leading, count = np.empty(before.size, np.int32), 0
    for cell in np.flatnonzero(targets):
        for state in range(HEADINGS * cell, HEADINGS * (cell + 1)):
            for action in range(ACTIONS):
                leading[count] = ACTIONS * before[state, action] + action
                count += 1
    return leading[:count]


@compiled()
def _changed_moves(old_words: np.ndarray, new_words: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return the moves in which two maps differ; the words hold the same bytes as the maps, eight to a word."""
    changed, count = np.empty(len(new), np.int32), 0
    for word in range(len(new_words)):
        if old_words[word] != new_words[word]:
            for move in range(8 * word, 8 * word + 8):
                changed[count] = move
                count += old[move] != new[move]
    return changed[:count]


@compiled()
def _repair(
    cost: np.ndarray,
    blocked: np.ndarray,
    changed: np.ndarray,
    action_costs: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
) -> None:
    """Update costs in place after some moves were blocked or unblocked. The cost of a target is 0 and stays 0.

    First, a state loses its cost if no unblocked move supports that cost any more, directly or through other states
    that lost theirs. Then new costs spread from the neighbours of these states and through the moves that were
    unblocked. They spread in ascending order, in bands as wide as the least action cost. No action leads from a state
    of a band to another state of the same band, so each state is expanded once.

    Args:
        cost: `(states,)` float64, costs on the map before the changes; updated in place.
        blocked: `(states * 5,)` bool, moves that are blocked on the present map.
        changed: `(n,)` int32, moves in which the present map differs from the one before.
        action_costs: `(8, 5)`, by heading before the action.
        before: table `lattice.predecessors_or_self`.
        after: table `lattice.successors_or_self`.
    """
    states = len(before)
    suspects, suspected = np.empty(len(changed) + ACTIONS * states, np.int32), 0
    for move in changed:
        if blocked[move]:
            suspects[suspected] = move // ACTIONS
            suspected += 1
    lost, lost_states, losses = np.zeros(states, np.bool_), np.empty(states, np.int32), 0
    while suspected:
        suspected -= 1
        state = suspects[suspected]
        settled = lost[state] or cost[state] == 0.0 or cost[state] == np.inf
        for action in range(ACTIONS):
            if settled:
                break
            if not blocked[ACTIONS * state + action]:
                end = after[state, action]
                settled = not lost[end] and cost[end] + action_costs[state & 7, action] == cost[state]
        if settled:
            continue
        lost[state] = True
        lost_states[losses] = state
        losses += 1
        for action in range(ACTIONS):
            previous = before[state, action]
            if not lost[previous] and cost[previous] == cost[state] + action_costs[previous & 7, action]:
                suspects[suspected] = previous
                suspected += 1
    for index in range(losses):
        cost[lost_states[index]] = np.inf
    front, in_front = np.empty(states + 1, np.uint32), np.zeros(states, np.bool_)
    count = np.uint64(0)
    for index in range(ACTIONS * losses + len(changed)):
        if index < ACTIONS * losses:
            move = ACTIONS * lost_states[index // ACTIONS] + index % ACTIONS
        else:
            move = changed[index - ACTIONS * losses]
        state, action = move // ACTIONS, move % ACTIONS
        total = cost[after[state, action]] + action_costs[state & 7, action]
        if not blocked[move] and total < cost[state]:
            cost[state] = total
            front[count] = state
            count += np.uint64(not in_front[state])
            in_front[state] = True
    width = action_costs.min()
    while count:
        band = np.inf
        for index in range(count):
            band = min(band, cost[front[index]])
        band += width
        read, kept = np.uint64(0), np.uint64(0)
        while read < count:
            state = np.uint64(front[read])
            read += np.uint64(1)
            so_far = cost[state]
            if so_far >= band:
                front[kept] = state
                kept += np.uint64(1)
                continue
            in_front[state] = False
            for action in range(np.uint64(ACTIONS)):  # without branches, which the processor could not predict
                previous = np.uint64(before[state, action])
                total, old = so_far + action_costs[previous & np.uint64(7), action], cost[previous]
                better = (not blocked[previous * np.uint64(ACTIONS) + action]) & (total < old)
                cost[previous] = total if better else old
                front[count] = previous
                count += np.uint64(better & (not in_front[previous]))
                in_front[previous] |= better
        count = kept
