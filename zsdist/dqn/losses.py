"""Losses of deep Q-learning and their gradients as pure functions of tensors.

`_t` is the time of the state acted in, `_tp1` the time of its successor. Shapes: `B` transitions, `A` actions.
"""

import torch


def td_targets(
    reward_t: torch.Tensor,
    discount_t: torch.Tensor,
    target_q_tp1: torch.Tensor,
    mask_tp1: torch.Tensor,
    online_q_tp1: torch.Tensor | None = None,
) -> torch.Tensor:
    """What Q(s_t, a_t) should be, `(B,)` float32: Eq. (10).

    `r_t + discount_t * max_a' Q'(s_{t+1}, a')` over the actions allowed in `s_{t+1}`; where `discount_t` is 0 (goal,
    collision) the reward alone.

    Deviation: the paper's has no terminal case; with `online_q_tp1` the online network picks a' and the target
    network values it (double Q-learning); actions that leave the grid are left out of the maximum.

    Args:
        reward_t: `(B,)` float32.
        discount_t: `(B,)` float32 in [0, 1].
        target_q_tp1: `(B, A)` float32, values of the target network.
        mask_tp1: `(B, A)` bool, allowed actions; each row with a positive discount must allow one.
        online_q_tp1: `(B, A)` float32, values of the policy network, for double Q-learning.
    """
    _check(reward_t, 1, torch.float32)
    _check(discount_t, 1, torch.float32)
    _check(target_q_tp1, 2, torch.float32)
    _check(mask_tp1, 2, torch.bool)
    chooser = target_q_tp1 if online_q_tp1 is None else online_q_tp1
    _check(chooser, 2, torch.float32)
    action_tp1 = chooser.masked_fill(~mask_tp1, -torch.inf).argmax(dim=1, keepdim=True)
    value_tp1 = target_q_tp1.gather(1, action_tp1).squeeze(1)
    return reward_t + discount_t * value_tp1


def td_error(q_t: torch.Tensor, action_t: torch.Tensor, target_t: torch.Tensor) -> torch.Tensor:
    """`Q(s_t, a_t) - target_t`, `(B,)`.

    Args:
        q_t: `(B, A)` float32.
        action_t: `(B,)` int64.
        target_t: `(B,)` float32, taken as constant.
    """
    _check(q_t, 2, torch.float32)
    _check(action_t, 1, torch.int64)
    _check(target_t, 1, torch.float32)
    return q_t.gather(1, action_t.unsqueeze(1)).squeeze(1) - target_t


def td_loss(error_t: torch.Tensor, huber: bool) -> torch.Tensor:
    """Mean loss of `td_error`: Huber with its bend at 1, or half the square."""
    bounded = _bounded(error_t, huber)
    return (bounded * (error_t - 0.5 * bounded)).mean()


def td_gradient(q_t: torch.Tensor, action_t: torch.Tensor, error_t: torch.Tensor, huber: bool) -> torch.Tensor:
    """Gradient of `td_loss` with respect to `q_t`, `(B, A)`; both kinds have the same for errors below 1."""
    rows = _bounded(error_t, huber) / len(error_t)
    return torch.zeros_like(q_t).scatter_(1, action_t.unsqueeze(1), rows.unsqueeze(1))


def margin_loss(q_t: torch.Tensor, mask_t: torch.Tensor, guide_t: torch.Tensor, margin: float) -> torch.Tensor:
    """How far guide actions are from being best by `margin`, averaged over the batch.

    `max_a [Q(s, a) + margin * (a != guide)] - Q(s, guide)` over allowed actions: the large-margin loss of deep
    Q-learning from demonstrations. Rows count nothing where there is no guide action or it is not allowed.

    Args:
        q_t: `(B, A)` float32.
        mask_t: `(B, A)` bool, allowed actions.
        guide_t: `(B,)` int64, negative where the guide has nothing to say.
        margin: in units of value.
    """
    guide, counts, lifted = _lifted(q_t, mask_t, guide_t, margin)
    return torch.where(counts, lifted.amax(dim=1, keepdim=True) - q_t.gather(1, guide), 0.0).mean()


def margin_gradient(q_t: torch.Tensor, mask_t: torch.Tensor, guide_t: torch.Tensor, margin: float) -> torch.Tensor:
    """Gradient of `margin_loss` with respect to `q_t`, `(B, A)`."""
    guide, counts, lifted = _lifted(q_t, mask_t, guide_t, margin)
    share = counts * (1.0 / len(q_t))
    return (
        torch.zeros_like(q_t).scatter_add_(1, lifted.argmax(dim=1, keepdim=True), share).scatter_add_(1, guide, -share)
    )


def _bounded(error_t: torch.Tensor, huber: bool) -> torch.Tensor:
    _check(error_t, 1, torch.float32)
    return error_t.clamp(-1.0, 1.0) if huber else error_t


def _lifted(
    q_t: torch.Tensor, mask_t: torch.Tensor, guide_t: torch.Tensor, margin: float
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Guide actions `(B, 1)`, whether each counts, and the values of all allowed actions, others than it lifted."""
    _check(q_t, 2, torch.float32)
    _check(mask_t, 2, torch.bool)
    _check(guide_t, 1, torch.int64)
    guide = guide_t.clamp_min(0).unsqueeze(1)
    counts = (guide_t.unsqueeze(1) >= 0) & mask_t.gather(1, guide)
    lifted = (q_t + margin).scatter_(1, guide, q_t.gather(1, guide)).masked_fill_(~mask_t, -torch.inf)
    return guide, counts, lifted


def _check(tensor: torch.Tensor, rank: int, dtype: torch.dtype) -> None:
    assert tensor.ndim == rank and tensor.dtype == dtype, (tensor.shape, tensor.dtype, rank, dtype)
