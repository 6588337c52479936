"""Costs to go to one target, kept up while the map changes: a look changes few ways, so no search need begin anew."""

import numpy as np
from numba import njit

from zsdist.planning.grid import HEADINGS
from zsdist.planning.lattice import ends, origins


class CostField:
    """What `cost_to_go` finds for one target, of every state, on one map after another.

    Args:
        targets: `[iy, ix]` `(cells, cells)` bool.
        action_costs: `(8, 5)`, by heading before the action, above 0.
    """

    def __init__(self, targets: np.ndarray, action_costs: np.ndarray) -> None:
        self.targets = targets
        self._action_costs = np.asarray(action_costs, dtype=np.float64)
        cells = len(targets)
        self._blocked = np.ones((cells, cells, HEADINGS, self._action_costs.shape[1]), np.bool_)
        self._exact = np.where(np.repeat(targets.ravel(), HEADINGS), 0.0, np.inf)
        self._cost = self._exact.astype(np.float32).reshape(cells, cells, HEADINGS)

    def on(self, blocked: np.ndarray) -> np.ndarray:
        """Least cost from every state to the target, `[iy, ix, heading]` `(cells, cells, 8)` float32; infinite: no way.

        Args:
            blocked: `(cells, cells, 8, 5)` bool, contiguous; not to be changed before the next call.
        """
        if blocked is not self._blocked:
            cells = len(blocked)
            old, new = np.ravel(self._blocked), np.ravel(blocked)
            changed = _changed(old.view(np.uint64), new.view(np.uint64), old, new)
            if len(changed):
                _repair(self._exact, new, changed, self._action_costs, origins(cells), ends(cells))
                self._cost = self._exact.astype(np.float32).reshape(cells, cells, HEADINGS)
            self._blocked = blocked
        return self._cost


@njit(cache=True)
def _changed(old_words: np.ndarray, new_words: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Ways, `state * actions + action`, in which two maps differ; `words` are the same in eights."""
    changed, count = np.empty(len(new), np.int32), 0
    for word in range(len(new_words)):
        if old_words[word] != new_words[word]:
            for way in range(8 * word, 8 * word + 8):
                changed[count] = way
                count += old[way] != new[way]
    return changed[:count]


@njit(cache=True)
def _repair(
    cost: np.ndarray,
    blocked: np.ndarray,
    changed: np.ndarray,
    action_costs: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
) -> None:
    """Makes costs that held before some ways changed those of the present map; of a target they are 0 and stay so.

    First the states whose cost rested on ways that are closed now, and by them on one another, lose it. Then what these
    and the ways that opened get from their neighbours spreads in the order of costs, in bands as wide as the least
    action cost: no action leads from a state of a band to another of it, so that each state is followed up once.
    """
    states, actions = before.shape
    suspects, suspected = np.empty(len(changed) + actions * states, np.int32), 0
    for way in changed:
        if blocked[way]:
            suspects[suspected] = way // actions
            suspected += 1
    lost, without, losses = np.zeros(states, np.bool_), np.empty(states, np.int32), 0
    while suspected:
        suspected -= 1
        state = suspects[suspected]
        held = lost[state] or cost[state] == 0.0 or cost[state] == np.inf
        for action in range(actions):
            if held:
                break
            if not blocked[state * actions + action]:
                end = after[state, action]
                held = not lost[end] and cost[end] + action_costs[state & 7, action] == cost[state]
        if held:
            continue
        lost[state] = True
        without[losses] = state
        losses += 1
        for action in range(actions):
            previous = before[state, action]
            if not lost[previous] and cost[previous] == cost[state] + action_costs[previous & 7, action]:
                suspects[suspected] = previous
                suspected += 1
    for index in range(losses):
        cost[without[index]] = np.inf
    front, count, known = np.empty(states + 1, np.int32), 0, np.zeros(states, np.bool_)
    for index in range(losses + len(changed)):
        state = without[index] if index < losses else changed[index - losses] // actions
        if index > losses and state == changed[index - losses - 1] // actions:
            continue
        for action in range(actions):
            if not blocked[state * actions + action]:
                total = cost[after[state, action]] + action_costs[state & 7, action]
                if total < cost[state]:
                    cost[state] = total
                    front[count] = state
                    count += not known[state]
                    known[state] = True
    width = action_costs.min()
    while count:
        band = np.inf
        for index in range(count):
            band = min(band, cost[front[index]])
        band += width
        read, kept = 0, 0
        while read < count:
            state = front[read]
            read += 1
            so_far = cost[state]
            if so_far >= band:
                front[kept] = state
                kept += 1
                continue
            known[state] = False
            for action in range(actions):
                previous = before[state, action]
                total = so_far + action_costs[previous & 7, action]
                if total < cost[previous] and not blocked[previous * actions + action]:
                    cost[previous] = total
                    front[count] = previous
                    count += not known[previous]
                    known[previous] = True
        count = kept
