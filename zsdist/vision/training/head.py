"""Training of the visual-act head on tokens that are computed once: Algorithm 1 of the paper.

Deviation: the encoder stays frozen and only the head learns; R_p follows from the predicted clearance and kind of
obstacle with the goal given (`labels.reward_label`), and rays are learned beside it.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch

from zsdist.vision.labels import expected_openness, reward_label
from zsdist.vision.models.head import VisualActHead
from zsdist.vision.rays import BIN_CENTRES_M
from zsdist.vision.training.examples import Examples, Targets, targets, token_spread
from zsdist.vision.training.losses import action_losses, distance_loss, kind_loss, total_loss
from zsdist.vision.training.trainer import Losses, Recipe, Trainer

if TYPE_CHECKING:
    from zsdist.vision.training.contrast import Contrast

CLEARANCE_WEIGHT = 0.5
KIND_WEIGHT = 0.2
CONTRAST_WEIGHT = 0.1  # lambda of the total loss


def loss(
    head: VisualActHead, batch: Targets, contrast: torch.Tensor | None = None
) -> tuple[torch.Tensor, dict[str, float]]:
    """Loss of a batch, and its parts as numbers: the sum of L_a, L_c, and the terms that train what R_p is made of."""
    clearance, dynamic, rays, _ = head(batch.tokens)
    centres = torch.from_numpy(BIN_CENTRES_M)
    room = expected_openness(clearance.softmax(-1), centres, dynamic.sigmoid(), batch.goal_distance_m)
    of_actions = action_losses(reward_label(room, batch.progress), batch.reward)
    parts = {
        "clearance": CLEARANCE_WEIGHT * distance_loss(clearance, batch.clearance),
        "kind": KIND_WEIGHT * kind_loss(dynamic, batch.dynamic, batch.present),
        "rays": distance_loss(rays, batch.rays),
    }
    total = total_loss(of_actions, torch.zeros(()) if contrast is None else contrast, CONTRAST_WEIGHT)
    numbers = {"actions": of_actions.sum(), **parts}
    if contrast is not None:
        numbers["contrast"] = CONTRAST_WEIGHT * contrast
    return total + sum(parts.values()), {name: float(number.detach()) for name, number in numbers.items()}


def new_head(examples: Examples, field_of_view_rad: float, seed: int) -> VisualActHead:
    """A head with random weights that expects tokens of the mean and spread of `examples`."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        head = VisualActHead(examples.tokens.shape[-1], examples.tokens.shape[1], field_of_view_rad)
    head.normalise_to(*token_spread(examples.tokens))
    return head


def train(
    head: VisualActHead,
    examples: Examples,
    validation: Examples,
    recipe: Recipe,
    rng: np.random.Generator,
    time_used: Callable[[], float],
    contrast: "Contrast | None" = None,
) -> Trainer:
    """Trains `head` in place, an epoch each `next`; ends with the weights of the epoch that was best on `validation`.

    The views come in a new order and a half of them mirrored in each epoch.

    Args:
        head: from `new_head`.
        examples: to learn from.
        validation: views of scenes that are not among `examples`.
        recipe: how.
        rng: decides orders, mirrors, goals and pairs to contrast.
        time_used: share of the time allowed that is gone.
        contrast: of where the actions look; None: without.
    """

    def losses(rng: np.random.Generator) -> Losses:
        order, mirrored = rng.permutation(len(examples)), rng.random(len(examples)) < 0.5
        for start in range(0, len(order), recipe.batch):
            chosen = order[start : start + recipe.batch]
            yield loss(head, targets(examples, chosen, mirrored[chosen], rng), contrast and contrast.loss(head, rng))

    steps = math.ceil(len(examples) / recipe.batch)
    return Trainer(head, recipe, steps, losses, lambda: validate(head, validation, recipe.batch), rng, time_used)


def validate(head: VisualActHead, examples: Examples, batch: int) -> dict[str, float]:
    """Mean of each part of the loss over `examples`, with the same goals at each call."""
    head.eval()
    rng, sums = np.random.default_rng(0), {}
    with torch.no_grad():
        for start in range(0, len(examples), batch):
            index = np.arange(start, min(start + batch, len(examples)))
            _, parts = loss(head, targets(examples, index, np.zeros(len(index), bool), rng))
            for name, part in parts.items():
                sums[name] = sums.get(name, 0.0) + part * len(index)
    return {name: value / len(examples) for name, value in sums.items()}
