"""Losses of deep Q-learning and their gradients as pure functions of arrays, compiled because batches are small.

Suffixes of names give the time: `_t` the state acted in, `_tp1` its successor. Shapes: `B` transitions, `A` actions.
"""

import numpy as np

from zsdist.common.compiled import compiled


def td_targets(
    reward_t: np.ndarray,
    discount_t: np.ndarray,
    target_q_tp1: np.ndarray,
    mask_tp1: np.ndarray,
    online_q_tp1: np.ndarray | None = None,
) -> np.ndarray:
    """Return the targets of Q(s_t, a_t), `(B,)` float32: Eq. (10).

    A target is `r_t + discount_t * max_a' Q'(s_{t+1}, a')` over the actions allowed in `s_{t+1}`, and only `r_t` where
    `discount_t` is 0 (goal, collision).

    Deviation: the paper's equation has no terminal case. With `online_q_tp1` the online network picks a' and the target
    network values it (double Q-learning). Actions that leave the grid are excluded from the maximum.

    Args:
        reward_t: `(B,)` float32, scaled rewards.
        discount_t: `(B,)` float32 in [0, 1].
        target_q_tp1: `(B, A)` float32, values of the target network.
        mask_tp1: `(B, A)` bool, allowed actions; each row with a positive discount must allow one.
        online_q_tp1: `(B, A)` float32, values of the policy network, for double Q-learning.
    """
    chooser = target_q_tp1 if online_q_tp1 is None else online_q_tp1
    for array, rank in ((reward_t, 1), (discount_t, 1), (target_q_tp1, 2), (chooser, 2)):
        _check(array, rank, np.float32)
    _check(mask_tp1, 2, np.bool_)
    return _targets(reward_t, discount_t, target_q_tp1, mask_tp1, chooser)


@compiled()
def td_error(q_t: np.ndarray, action_t: np.ndarray, target_t: np.ndarray) -> np.ndarray:
    """Return the temporal-difference errors `Q(s_t, a_t) - target_t`, `(B,)`.

    Args:
        q_t: `(B, A)` float32, values of the policy network.
        action_t: `(B,)` int64, actions taken.
        target_t: `(B,)` float32, targets, treated as constants.
    """
    errors = np.empty_like(target_t)
    for row in range(len(errors)):
        errors[row] = q_t[row, action_t[row]] - target_t[row]
    return errors


def td_loss(error_t: np.ndarray, huber: bool) -> float:
    """Return the mean loss of temporal-difference errors: Huber with its bend at 1, or half the square."""
    bounded = error_t.clip(-1, 1) if huber else error_t
    return float((bounded * (error_t - bounded / 2)).mean())


@compiled()
def td_gradient(q_t: np.ndarray, action_t: np.ndarray, error_t: np.ndarray, huber: bool) -> np.ndarray:
    """Return the gradient of `td_loss` with respect to `q_t`, `(B, A)`; both losses share it for errors below 1."""
    gradient, rows = np.zeros_like(q_t), np.float32(len(error_t))
    for row in range(len(error_t)):
        error = error_t[row]
        if huber:
            error = min(max(error, np.float32(-1.0)), np.float32(1.0))
        gradient[row, action_t[row]] = error / rows
    return gradient


def margin_loss(q_t: np.ndarray, mask_t: np.ndarray, guide_t: np.ndarray, margin: float) -> float:
    """Return the mean large-margin loss, which is 0 where the guide action exceeds all others by `margin`.

    The loss of a row is `max_a [Q(s, a) + margin * (a != guide)] - Q(s, guide)` over allowed actions, as in deep
    Q-learning from demonstrations. A row without an allowed guide action adds 0 but counts in the mean.

    Args:
        q_t: `(B, A)` float32, values of the policy network.
        mask_t: `(B, A)` bool, allowed actions.
        guide_t: `(B,)` int64, actions of the guide, negative where it has no advice.
        margin: lead over all other actions that the guide action must have, in units of value.
    """
    rivals = _rivals(q_t, mask_t, guide_t, np.float32(margin))
    rows = np.flatnonzero(rivals >= 0)
    rivals, guides = rivals[rows], guide_t[rows]
    return float((q_t[rows, rivals] + margin * (rivals != guides) - q_t[rows, guides]).sum() / len(q_t))


@compiled()
def margin_gradient(q_t: np.ndarray, mask_t: np.ndarray, guide_t: np.ndarray, margin: float) -> np.ndarray:
    """Return the gradient of `margin_loss` with respect to `q_t`, `(B, A)`."""
    gradient, share = np.zeros_like(q_t), np.float32(1.0 / len(q_t))
    rivals = _rivals(q_t, mask_t, guide_t, np.float32(margin))
    for row in range(len(q_t)):
        if rivals[row] >= 0:
            gradient[row, rivals[row]] += share
            gradient[row, guide_t[row]] -= share
    return gradient


@compiled()
def _targets(
    reward_t: np.ndarray,
    discount_t: np.ndarray,
    target_q_tp1: np.ndarray,
    mask_tp1: np.ndarray,
    chooser_q_tp1: np.ndarray,
) -> np.ndarray:
    targets = np.empty_like(reward_t)
    for row in range(len(targets)):
        best = _best(chooser_q_tp1[row], mask_tp1[row])
        targets[row] = reward_t[row] + discount_t[row] * target_q_tp1[row, best]
    return targets


@compiled()
def _rivals(q_t: np.ndarray, mask_t: np.ndarray, guide_t: np.ndarray, margin: np.float32) -> np.ndarray:
    """Return each row's best allowed action after all but the guide's are raised by `margin`; -1: guide not allowed."""
    rivals, lifted = np.full(len(q_t), -1), np.empty_like(q_t[0])
    for row in range(len(q_t)):
        guide = guide_t[row]
        if guide >= 0 and mask_t[row, guide]:
            for action in range(len(lifted)):
                lifted[action] = q_t[row, action] + margin if action != guide else q_t[row, action]
            rivals[row] = _best(lifted, mask_t[row])
    return rivals


@compiled()
def _best(values: np.ndarray, mask: np.ndarray) -> int:
    """Return the allowed action with the highest value, the first one of a tie; 0 if none is allowed."""
    best, highest = 0, -np.inf
    for action in range(len(values)):
        if mask[action] and values[action] > highest:
            best, highest = action, values[action]
    return best


def _check(array: np.ndarray, rank: int, dtype: type) -> None:
    """Check rank and dtype, so that a wrong shape fails instead of being broadcast."""
    assert array.ndim == rank and array.dtype == dtype, (array.shape, array.dtype, rank, dtype)
