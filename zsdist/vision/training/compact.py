"""Training of the compact network on fresh pictures with their truth.

A network without pretrained features learns from many pictures what the head has from its encoder, and simulated
pictures cost little. So each picture is used in one epoch only: as it is and mirrored.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np
import torch

from zsdist.vision.models.compact import Compact
from zsdist.vision.rays import exact_labels
from zsdist.vision.training.examples import Examples, targets
from zsdist.vision.training.head import loss, validate
from zsdist.vision.training.trainer import Losses, Recipe, Trainer


def new_compact(field_of_view_rad: float, seed: int) -> Compact:
    """Return a compact network with random weights."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return Compact(field_of_view_rad)


def train(
    network: Compact,
    pictures: int,
    epochs: Callable[[int], Iterator[Examples]],
    validation: Examples,
    recipe: Recipe,
    rng: np.random.Generator,
    time_used: Callable[[], float],
) -> Trainer:
    """Return a trainer of `network`. Each `next` is one epoch; the end loads the best weights on `validation`.

    Args:
        network: network from `new_compact`; trained in place.
        pictures: number of pictures of an epoch.
        epochs: function that returns the pictures of all epochs from a given one on, in place of tokens.
        validation: pictures of other scenes.
        recipe: settings of the training.
        rng: source of orders and goals.
        time_used: function that returns the used share of the time budget.
    """
    coming: list[Iterator[Examples]] = []

    def losses(rng: np.random.Generator) -> Losses:
        if not coming:
            coming.append(epochs(trainer.epoch))
        examples = next(coming[0])
        order = rng.permutation(2 * len(examples))
        for start in range(0, len(order), recipe.batch):
            chosen = order[start : start + recipe.batch]
            mirrored = chosen >= len(examples)
            yield loss(network, targets(examples, chosen % len(examples), mirrored, rng, exact_labels))

    trainer = Trainer(
        network,
        recipe,
        math.ceil(2 * pictures / recipe.batch),
        losses,
        lambda: validate(network, validation, recipe.batch, exact_labels),
        rng,
        time_used,
    )
    return trainer
