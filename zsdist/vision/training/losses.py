"""Losses of Algorithm 1: of the actions' rewards, of distances as distributions over bins, and the contrast."""

from typing import Literal

import torch
from torch import Tensor

RANKED_WEIGHT = 0.3
TEMPERATURE = 0.1  # of the contrast

Form = Literal["difference", "literal"]


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


def total_loss(of_actions: Tensor, contrast: Tensor, contrast_weight: float) -> Tensor:
    """Eq. (5), `L_total = sum_a L_a + lambda L_c`, a scalar.

    Args:
        of_actions: `(3,)`, each L_a.
        contrast: scalar, L_c.
        contrast_weight: lambda.
    """
    return of_actions.sum() + contrast_weight * contrast


def contrastive_loss(
    anchors: Tensor,
    original: Tensor,
    masked: Tensor,
    positive: Tensor,
    negative: Tensor,
    weight: Tensor,
    form: Form = "difference",
    temperature: float = TEMPERATURE,
) -> Tensor:
    """Eq. (6): `L_c = -log exp(s+ / tau) / (exp(s+ / tau) + sum over x- of exp(s- / tau))`, a scalar.

    `s` is the cosine of an anchor I_a and a sample. The mean is over the anchors that have samples of both kinds and
    over the positive samples of each; other anchors are skipped, and where there are none the loss is 0.

    Deviation: a sample is by default the difference `E - E_i` of the embeddings of the picture and of the masked
    picture, which is what the hidden thing gave to the picture. The literal sample is `E_i` itself: it pulls I_a
    towards a picture in which the thing that matters to the action is hidden, and so away from the thing. Both are
    here to be compared: of two heads of one seed in wild pictures, I_a was nearest to the object in direction a in 0.75
    to 0.93 of them by kind with the difference, in 0.45 to 0.77 with the literal form.

    Args:
        anchors: `(B, 3, D)`, I_1 to I_3.
        original: `(B, D)`, E, the mean of the projected tokens (in the difference form it must not be normalised).
        masked: `(B, M, D)`, E_i likewise.
        positive: `(B, 3, M)` bool, for which actions the masked picture's label has changed.
        negative: `(B, 3, M)` bool, for which it has not; a place that holds no masked picture is neither.
        weight: `(B, M)`, of each sample among the negative ones; less than 1 for the background.
        form: which sample.
        temperature: tau.
    """
    samples = original[:, None] - masked if form == "difference" else masked
    logits = torch.nn.functional.normalize(anchors, dim=-1) @ torch.nn.functional.normalize(samples, dim=-1).mT
    logits = logits / temperature
    rest = (logits + weight.clamp(min=1e-6).log()[:, None]).masked_fill(~negative, -torch.inf).logsumexp(-1)
    counted = positive & negative.any(-1, keepdim=True)
    apart = torch.nn.functional.softplus(rest[..., None] - logits).masked_fill(~counted, 0.0)
    each = apart.sum(-1) / counted.sum(-1).clamp(min=1)
    return each.sum() / counted.any(-1).sum().clamp(min=1)


def attention_error(attention: Tensor, wanted: Tensor, unwanted: Tensor) -> Tensor:
    """How far the attention is from what masks say it should be on, a scalar: the "attention matrix error" of Sec. 3.2.

    The mean of `-log` of the attention on what is wanted, over the actions for which anything is, and of `-log` of the
    attention that is not on what is unwanted. It stands beside L_c, which compares embeddings and alone leaves much of
    the attention on the ground: of ten settings of L_c none brought the likeness of I_1 to I_3 to the ground's word
    below that of I_0 in more than 0.77 of wild pictures; with this beside it, it was 0.84 to 0.86 on the same pictures.

    Args:
        attention: `(B, 3, T)`, each sums to 1.
        wanted: `(B, 3, T)`, 0 to 1, where each action should look.
        unwanted: `(B, T)`, 0 to 1, where none should.
    """
    told = wanted.amax(-1) > 0.5
    missed = -(attention * wanted).sum(-1).clamp(min=1e-4).log()
    strayed = -(1 - (attention * unwanted[:, None]).sum(-1)).clamp(min=1e-4).log()
    return (missed * told).sum() / told.sum().clamp(min=1) + strayed.mean()
