"""Batches in the form that a learner computes with: float32, with states stacked on next states, and reflected."""

from typing import NamedTuple, Self

import numpy as np

from zsdist.common import half_precision
from zsdist.common.compiled import compiled
from zsdist.types import Batch, Mirror, StoredBatch


def from_stored(stored: StoredBatch) -> Batch:
    """Return a stored batch in the dtypes of a learner."""
    return Batch(
        states=half_precision.from_half(stored.states),
        actions=stored.actions.astype(np.int64),
        rewards=stored.rewards,
        discounts=stored.discounts,
        next_states=half_precision.from_half(stored.next_states),
        next_masks=stored.next_masks,
        masks=stored.masks,
        guides=stored.guides.astype(np.int64),
        weights=stored.weights,
        serials=stored.serials,
    )


class StackedBatch(NamedTuple):
    """Columns of a batch that a reflection changes.

    In an array of `2 B` rows the first `B` belong to time `t`, the others to `t + 1`.

    Attributes:
        states: `(2 B, D)` float32, states and next states.
        masks: `(2 B, A)` bool, actions allowed in them.
        actions: `(B,)` int64, actions taken.
        guides: `(B,)` int64, actions of the guide; negative: none.
    """

    states: np.ndarray
    masks: np.ndarray
    actions: np.ndarray
    guides: np.ndarray

    @classmethod
    def of(cls, batch: Batch) -> Self:
        """Return a copy of a batch's columns."""
        return cls(
            np.concatenate((batch.states, batch.next_states)),
            np.concatenate((batch.masks, batch.next_masks)),
            batch.actions.copy(),
            batch.guides.copy(),
        )

    def reflect(self, mirror: Mirror, rows: np.ndarray) -> None:
        """Reflect the chosen rows (`(B,)` bool) left to right, in place."""
        _reflect(*self, rows, mirror.state_index, mirror.state_sign, mirror.action_index)


@compiled()
def _reflect(
    states: np.ndarray,
    masks: np.ndarray,
    actions: np.ndarray,
    guides: np.ndarray,
    rows: np.ndarray,
    state_index: np.ndarray,
    state_sign: np.ndarray,
    action_index: np.ndarray,
) -> None:
    before, allowed = np.empty_like(states[0]), np.empty_like(masks[0])
    for row in np.flatnonzero(rows):
        actions[row] = action_index[actions[row]]
        if guides[row] >= 0:
            guides[row] = action_index[guides[row]]
        for at in (row, row + len(rows)):
            before[:], allowed[:] = states[at], masks[at]
            for feature in range(len(state_index)):
                states[at, feature] = before[state_index[feature]] * state_sign[feature]
            for action in range(len(action_index)):
                masks[at, action] = allowed[action_index[action]]
