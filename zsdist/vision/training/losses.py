"""Losses of Algorithm 1: of the actions' rewards, and of distances as distributions over bins."""

import torch
from torch import Tensor

RANKED_WEIGHT = 0.3


def action_losses(predicted: Tensor, labels: Tensor) -> Tensor:
    """L_a of Algorithm 1, line 17, the norm of `R_p - R` over a batch for each action, `(3,)`.

    Divided by the root of the batch size, so that it does not grow with it.

    Args:
        predicted: `(B, 3)`, R_p.
        labels: `(B, 3)`, R.
    """
    return ((predicted - labels).square().mean(0) + 1e-8).sqrt()  # the root has no gradient at zero


def distance_loss(logits: Tensor, labels: Tensor) -> Tensor:
    """Cross-entropy with soft labels plus a weighted ranked probability score, a scalar.

    The cross-entropy does not know that bins are in order; the ranked probability score, the squared difference of
    the cumulated distributions, does.

    Args:
        logits: `(..., K)`.
        labels: `(..., K)`, distributions.
    """
    log = logits.log_softmax(-1)
    ranked = (log.exp().cumsum(-1) - labels.cumsum(-1)).square().sum(-1)
    return (-(labels * log).sum(-1) + RANKED_WEIGHT * ranked).mean()


def kind_loss(logits: Tensor, dynamic: Tensor, present: Tensor) -> Tensor:
    """Cross-entropy of dynamic or static, over the directions in which there is an obstacle; a scalar.

    Args:
        logits: `(B, 3)`.
        dynamic: `(B, 3)`, 1 where the obstacle is of a kind that moves.
        present: `(B, 3)` bool.
    """
    each = torch.nn.functional.binary_cross_entropy_with_logits(logits, dynamic, reduction="none")
    return (each * present).sum() / present.sum().clamp(min=1)
