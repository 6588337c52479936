"""Training of the visual-act head on tokens that are computed once: Algorithm 1 of the paper.

Deviation: the encoder stays frozen and only the head learns. R_p is computed from the predicted clearance and kind of
obstacle and from the given goal (`labels.reward_label`). The head also learns distances along rays.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

from zsdist.vision.labels import expected_openness, reward_label
from zsdist.vision.models.head import VisualActHead
from zsdist.vision.rays import BIN_CENTRES_M, soft_labels
from zsdist.vision.training.examples import Examples, Targets, targets, token_spread
from zsdist.vision.training.losses import action_losses, distance_loss, kind_loss, total_loss
from zsdist.vision.training.trainer import Losses, Recipe, Trainer

if TYPE_CHECKING:
    from zsdist.vision.training.contrast import Contrast

CLEARANCE_WEIGHT = 0.5
KIND_WEIGHT = 0.2
CONTRAST_WEIGHT = 0.1  # lambda of the total loss


def loss(
    network: nn.Module, batch: Targets, contrast: torch.Tensor | None = None
) -> tuple[torch.Tensor, dict[str, float]]:
    """Return the loss of a batch, and its parts as numbers: the sum of L_a, L_c, and the losses of R_p's ingredients.

    Args:
        network: head, or student with pictures in place of tokens.
        batch: inputs and labels.
        contrast: L_c; None: without.
    """
    clearance, dynamic, rays, _ = network(batch.tokens)
    centres = torch.from_numpy(BIN_CENTRES_M)
    openness = expected_openness(clearance.softmax(-1), centres, dynamic.sigmoid(), batch.goal_distance_m)
    of_actions = action_losses(reward_label(openness, batch.progress), batch.reward)
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
    """Return a head with random weights; it normalises tokens with the mean and spread of `examples`."""
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
    """Return a trainer of `head`. Each `next` is one epoch; the end loads the best weights on `validation`.

    In each epoch the views come in a new order, half of them mirrored.

    Args:
        head: head from `new_head`; trained in place.
        examples: training views.
        validation: views of scenes that are not among `examples`.
        recipe: settings of the training.
        rng: source of orders, mirrors, goals and pairs to contrast.
        time_used: function that returns the used share of the time budget.
        contrast: contrast of the actions' attention; None: without.
    """

    def losses(rng: np.random.Generator) -> Losses:
        order, mirrored = rng.permutation(len(examples)), rng.random(len(examples)) < 0.5
        for start in range(0, len(order), recipe.batch):
            chosen = order[start : start + recipe.batch]
            batch = targets(examples, chosen, mirrored[chosen], rng)
            yield loss(head, batch, None if contrast is None else contrast.loss(head, rng))

    steps = math.ceil(len(examples) / recipe.batch)
    return Trainer(head, recipe, steps, losses, lambda: validate(head, validation, recipe.batch), rng, time_used)


def validate(
    network: nn.Module,
    examples: Examples,
    batch: int,
    labels: Callable[[np.ndarray], np.ndarray] = soft_labels,
) -> dict[str, float]:
    """Return the mean of each part of the loss over `examples`, with the same goals at each call."""
    network.eval()
    rng = np.random.default_rng(0)
    sums: dict[str, float] = {}
    with torch.no_grad():
        for start in range(0, len(examples), batch):
            index = np.arange(start, min(start + batch, len(examples)))
            _, parts = loss(network, targets(examples, index, np.zeros(len(index), bool), rng, labels))
            for name, part in parts.items():
                sums[name] = sums.get(name, 0.0) + part * len(index)
    return {name: value / len(examples) for name, value in sums.items()}
