"""Training of the visual-act head on tokens that are computed once: Algorithm 1 of the paper, without its contrast.

Deviation: the encoder stays frozen and only the head learns; R_p follows from the predicted clearance and kind of
obstacle with the goal given (`labels.reward_label`), and rays are learned beside it.
"""

import hashlib
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch

from zsdist.vision.labels import expected_openness, reward_label
from zsdist.vision.models.head import VisualActHead
from zsdist.vision.rays import BIN_CENTRES_M
from zsdist.vision.training.examples import Examples, Targets, targets
from zsdist.vision.training.losses import action_losses, distance_loss, kind_loss
from zsdist.vision.visual_act import METADATA_FILE, WEIGHTS_FILE

CLEARANCE_WEIGHT = 0.5
KIND_WEIGHT = 0.2


@dataclass(frozen=True)
class Recipe:
    """How to train: passes over the data, views a step, the one cycle's peak, weight decay, and when to stop."""

    epochs: int = 30
    batch: int = 64
    learning_rate: float = 3e-3
    weight_decay: float = 0.02
    patience: int = 8  # epochs without a better validation loss


def loss(head: VisualActHead, batch: Targets) -> tuple[torch.Tensor, dict[str, float]]:
    """Loss of a batch, and its parts as numbers: the sum of L_a, and the terms that train what R_p is made of."""
    clearance, dynamic, rays, _ = head(batch.tokens)
    centres = torch.from_numpy(BIN_CENTRES_M)
    room = expected_openness(clearance.softmax(-1), centres, dynamic.sigmoid(), batch.goal_distance_m)
    actions = action_losses(reward_label(room, batch.progress), batch.reward).sum()
    parts = {
        "actions": actions,
        "clearance": CLEARANCE_WEIGHT * distance_loss(clearance, batch.clearance),
        "kind": KIND_WEIGHT * kind_loss(dynamic, batch.dynamic, batch.present),
        "rays": distance_loss(rays, batch.rays),
    }
    total = sum(parts.values())
    return total, {name: float(part.detach()) for name, part in parts.items()}


def new_head(examples: Examples, field_of_view_rad: float, seed: int) -> VisualActHead:
    """A head with random weights that expects tokens of the mean and spread of `examples`."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        head = VisualActHead(examples.tokens.shape[-1], examples.tokens.shape[1], field_of_view_rad)
    tokens = examples.tokens[:: max(1, len(examples) // 500)].astype(np.float32)
    head.normalise_to(tokens.mean((0, 1, 2)), tokens.std((0, 1, 2)))
    return head


def train(
    head: VisualActHead,
    examples: Examples,
    validation: Examples,
    recipe: Recipe,
    rng: np.random.Generator,
    time_used: Callable[[], float],
) -> Iterator[dict[str, float]]:
    """Trains `head` in place and ends with the weights of the epoch that was best on `validation`.

    AdamW with one cycle of the learning rate, the views in a new order and a half of them mirrored in each epoch.

    Args:
        head: from `new_head`.
        examples: to learn from.
        validation: views of scenes that are not among `examples`.
        recipe: how.
        rng: decides orders, mirrors and goals.
        time_used: share of the time allowed that is gone; the cycle hurries so as to end when it reaches 1.

    Yields:
        After each epoch `{"epoch", "learning_rate", "loss", "validation_loss", ...}` and the parts of the latter.
    """
    optimiser = torch.optim.AdamW(head.parameters(), lr=recipe.learning_rate, weight_decay=recipe.weight_decay)
    steps = recipe.epochs * math.ceil(len(examples) / recipe.batch)
    step, best, best_epoch, best_weights = 0, math.inf, 0, {}
    for epoch in range(1, recipe.epochs + 1):
        head.train()
        order, mirrored = rng.permutation(len(examples)), rng.random(len(examples)) < 0.5
        losses = []
        for start in range(0, len(order), recipe.batch):
            chosen = order[start : start + recipe.batch]
            rate = recipe.learning_rate * one_cycle(max(step / steps, min(time_used(), 1.0)))
            for group in optimiser.param_groups:
                group["lr"] = rate
            total, _ = loss(head, targets(examples, chosen, mirrored[chosen], rng))
            optimiser.zero_grad()
            total.backward()
            torch.nn.utils.clip_grad_norm_(head.parameters(), 5.0)
            optimiser.step()
            losses.append(float(total.detach()))
            step += 1
        parts = validate(head, validation, recipe.batch)
        found = sum(parts.values())
        if found < best:
            best, best_epoch = found, epoch
            best_weights = {name: value.clone() for name, value in head.state_dict().items()}
        yield {
            "epoch": epoch,
            "learning_rate": rate,
            "loss": float(np.mean(losses)),
            "validation_loss": found,
            **{f"validation_{name}": part for name, part in parts.items()},
        }
        if time_used() >= 1.0 or epoch - best_epoch >= recipe.patience:
            break
    head.load_state_dict(best_weights)


def one_cycle(share: float) -> float:
    """Learning rate over its peak at `share` of the training: up for the first fifth, then down to nothing."""
    return 0.05 + 0.95 * share / 0.2 if share < 0.2 else 0.5 * (1 + math.cos(math.pi * (share - 0.2) / 0.8))


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


def save(head: VisualActHead, folder: Path, metadata: dict[str, Any]) -> str:
    """Writes weights and metadata into `folder`, which `VisualAct.load` reads; returns the SHA-256 of the weights."""
    folder.mkdir(parents=True, exist_ok=True)
    content = safetensors.torch.save(head.state_dict())
    digest = hashlib.sha256(content).hexdigest()
    (folder / WEIGHTS_FILE).write_bytes(content)
    (folder / METADATA_FILE).write_text(json.dumps({"sha256": digest, **metadata}, indent=1) + "\n")
    return digest
