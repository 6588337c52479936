"""The two policies of Algorithm 2 and their union: the advice of the camera, and the potential field."""

from collections.abc import Callable
from operator import itemgetter

import numpy as np

from zsdist.types import Action, LatticeState

ADVISED = (Action.FORWARD, Action.LEFT_45, Action.RIGHT_45)  # actions in the order of a view's advice


def advised_action(advice: np.ndarray, mask: np.ndarray) -> Action | None:
    """Return the best allowed action by the visual-act model's advice. Eq. (12), a = pi(s_low | I).

    Args:
        advice: `(3,)` R_p for forward, left, right.
        mask: `(5,)` bool, allowed actions.

    Returns:
        The best advised action; None if no advised action is allowed.
    """
    allowed = mask.tolist()
    rated = [(value, action) for value, action in zip(advice.tolist(), ADVISED, strict=True) if allowed[action]]
    return max(rated, key=itemgetter(0))[1] if rated else None


class PolicyMap:
    """One episode's pool of advised actions and its union with the potential field."""

    def __init__(self) -> None:
        self._pool: dict[LatticeState, Action] = {}

    def add(self, state: LatticeState, action: Action) -> None:
        """Add the advised action at a pose to the explored policy. Eq. (13): the union of the advice over all poses."""
        self._pool[state] = action

    def explored(self, state: LatticeState) -> Action | None:
        """Return the explored policy's action; None for a pose at which the camera has given no advice."""
        return self._pool.get(state)

    def overall(
        self, state: LatticeState, block_explored: bool, unexplored: Callable[[], Action | None]
    ) -> tuple[Action | None, bool]:
        """Return the global policy's action, and whether the explored policy gave it. Eq. (17): the union of both.

        Deviation: in an explored block the advice is followed at poses that have advice. At all other poses the
        potential field is followed.

        Args:
            state: pose on the lattice.
            block_explored: whether enough of the block around the pose has been seen.
            unexplored: function that returns the potential field's action.
        """
        if block_explored and (action := self._pool.get(state)) is not None:
            return action, True
        return unexplored(), False
