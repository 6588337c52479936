"""Costs to go to one target, kept up while the map changes: a look changes few ways, so no search need begin anew."""

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.footprint import ACTIONS
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
        self._blocked: np.ndarray | None = None
        self._exact = np.where(np.repeat(targets.ravel(), HEADINGS), 0.0, np.inf)

    def on(self, blocked: np.ndarray) -> np.ndarray:
        """Least cost from every state to the target, `[iy, ix, heading]` `(cells, cells, 8)` float32; infinite: no way.

        Args:
            blocked: `(cells, cells, 8, 5)` bool, contiguous; not to be changed before the next call.
        """
        if blocked is self._blocked:
            return self._cost
        cells, new = len(blocked), blocked.ravel()
        if self._blocked is None:  # as after a map on which everything was blocked, of which this is what matters
            changed = _into(self.targets.ravel(), origins(cells))
        else:
            old = self._blocked.ravel()
            changed = _changed(old.view(np.uint64), new.view(np.uint64), old, new)
        if self._blocked is None or len(changed):
            _repair(self._exact, new, changed, self._action_costs, origins(cells), ends(cells))
            self._cost = self._exact.astype(np.float32).reshape(cells, cells, HEADINGS)
        self._blocked = blocked
        return self._cost


@compiled()
def _into(targets: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Ways, `state * actions + action`, that end in a target, by what precedes each action."""
    leading, count = np.empty(before.size, np.int32), 0
    for cell in np.flatnonzero(targets):
        for state in range(HEADINGS * cell, HEADINGS * (cell + 1)):
            for action in range(ACTIONS):
                leading[count] = ACTIONS * before[state, action] + action
                count += 1
    return leading[:count]


@compiled()
def _changed(old_words: np.ndarray, new_words: np.ndarray, old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Ways, `ACTIONS * state + action`, in which two maps differ; `words` are the same in eights."""
    changed, count = np.empty(len(new), np.int32), 0
    for word in range(len(new_words)):
        if old_words[word] != new_words[word]:
            for way in range(8 * word, 8 * word + 8):
                changed[count] = way
                count += old[way] != new[way]
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
    """Makes costs that held before some ways changed those of the present map; of a target they are 0 and stay so.

    First the states whose cost rested on ways that are closed now, and by them on one another, lose it. Then what these
    and the ways that opened get from their neighbours spreads in the order of costs, in bands as wide as the least
    action cost: no action leads from a state of a band to another of it, so that each state is followed up once.
    """
    states = len(before)
    suspects, suspected = np.empty(len(changed) + ACTIONS * states, np.int32), 0
    for way in changed:
        if blocked[way]:
            suspects[suspected] = way // ACTIONS
            suspected += 1
    lost, without, losses = np.zeros(states, np.bool_), np.empty(states, np.int32), 0
    while suspected:
        suspected -= 1
        state = suspects[suspected]
        held = lost[state] or cost[state] == 0.0 or cost[state] == np.inf
        for action in range(ACTIONS):
            if held:
                break
            if not blocked[ACTIONS * state + action]:
                end = after[state, action]
                held = not lost[end] and cost[end] + action_costs[state & 7, action] == cost[state]
        if held:
            continue
        lost[state] = True
        without[losses] = state
        losses += 1
        for action in range(ACTIONS):
            previous = before[state, action]
            if not lost[previous] and cost[previous] == cost[state] + action_costs[previous & 7, action]:
                suspects[suspected] = previous
                suspected += 1
    for index in range(losses):
        cost[without[index]] = np.inf
    front, known = np.empty(states + 1, np.uint32), np.zeros(states, np.bool_)
    count = np.uint64(0)
    for index in range(ACTIONS * losses + len(changed)):
        lost_way = index < ACTIONS * losses
        way = ACTIONS * without[index // ACTIONS] + index % ACTIONS if lost_way else changed[index - ACTIONS * losses]
        state, action = way // ACTIONS, way % ACTIONS
        total = cost[after[state, action]] + action_costs[state & 7, action]
        if not blocked[way] and total < cost[state]:
            cost[state] = total
            front[count] = state
            count += np.uint64(not known[state])
            known[state] = True
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
            known[state] = False
            for action in range(np.uint64(ACTIONS)):  # without branches, which nobody could foretell
                previous = np.uint64(before[state, action])
                total, old = so_far + action_costs[previous & np.uint64(7), action], cost[previous]
                better = (not blocked[previous * np.uint64(ACTIONS) + action]) & (total < old)
                cost[previous] = total if better else old
                front[count] = previous
                count += np.uint64(better & (not known[previous]))
                known[previous] |= better
        count = kept
