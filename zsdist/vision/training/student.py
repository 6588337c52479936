"""Training of the small network on pictures, by the truth and by what the trained head says of the same pictures.

The head's answers beside the truth made no clear difference where that was measured: 12,000 pictures, ten epochs, one
seed, best action right in 0.90 and 0.91 of two validation sets with them, in 0.90 and 0.92 without.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from zsdist.vision.models.head import VisualActHead
from zsdist.vision.models.student import Student
from zsdist.vision.training.examples import Examples, Targets, targets
from zsdist.vision.training.head import loss, validate
from zsdist.vision.training.trainer import Losses, Recipe, Trainer

TEACHER_SHARE = 0.5  # of a label that is the head's answer; the rest is the truth
GAIN_SPREAD = 0.15  # standard deviation of the logarithm of a picture's brightness, and half of it of each colour's
NOISE_LEVELS = 8.0  # most noise, in levels of 255


@dataclass(frozen=True)
class TeacherPredictions:
    """What the trained head says of N examples, as probabilities in float16.

    Attributes:
        clearance: `(N, 3, BINS)`.
        dynamic: `(N, 3)`.
        rays: `(N, RAYS, BINS)`.
    """

    clearance: np.ndarray
    dynamic: np.ndarray
    rays: np.ndarray


def predict_with_teacher(head: VisualActHead, examples: Examples, batch: int = 64) -> TeacherPredictions:
    """The answers of `head` to the tokens of `examples`."""
    head.eval()
    parts = []
    with torch.no_grad():
        for start in range(0, len(examples), batch):
            tokens = torch.from_numpy(examples.tokens[start : start + batch].astype(np.float32))
            clearance, dynamic, rays, _ = head(tokens)
            parts.append([part.half().numpy() for part in (clearance.softmax(-1), dynamic.sigmoid(), rays.softmax(-1))])
    return TeacherPredictions(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def new_student(field_of_view_rad: float, seed: int) -> Student:
    """A student with random weights."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return Student(field_of_view_rad)


def train(
    student: Student,
    examples: Examples,
    validation: Examples,
    recipe: Recipe,
    rng: np.random.Generator,
    time_used: Callable[[], float],
    teacher: TeacherPredictions | None = None,
) -> Trainer:
    """Trains `student` in place, an epoch each `next`; ends with the weights of the best epoch on `validation`.

    The pictures come in a new order, a half of them mirrored, each with a brightness, tint and noise of its own.

    Args:
        student: from `new_student`.
        examples: to learn from, with their pictures.
        validation: views of scenes that are not among `examples`, with their pictures.
        recipe: how.
        rng: decides orders, mirrors, goals and what is done to the pictures.
        time_used: share of the time allowed that is gone.
        teacher: what the head says of `examples`; None: the truth alone teaches.
    """
    pictures, unseen = with_image_tokens(examples), with_image_tokens(validation)

    def losses(rng: np.random.Generator) -> Losses:
        order, mirrored = rng.permutation(len(pictures)), rng.random(len(pictures)) < 0.5
        for start in range(0, len(order), recipe.batch):
            chosen = order[start : start + recipe.batch]
            batch = targets(pictures, chosen, mirrored[chosen], rng)
            if teacher is not None:
                batch = mix_labels(batch, teacher, chosen, mirrored[chosen])
            yield loss(student, replace(batch, tokens=augment_images(batch.tokens)))

    steps = math.ceil(len(examples) / recipe.batch)
    return Trainer(student, recipe, steps, losses, lambda: validate(student, unseen, recipe.batch), rng, time_used)


def with_image_tokens(examples: Examples) -> Examples:
    """The same examples with the pixels of the pictures in the place of tokens.

    Raises:
        ValueError: the pictures were not kept.
    """
    if examples.images is None:
        raise ValueError("the examples are without their pictures, which the student learns from")
    return replace(examples, tokens=examples.images)


def mix_labels(batch: Targets, teacher: TeacherPredictions, index: np.ndarray, mirrored: np.ndarray) -> Targets:
    """A batch whose labels are in part the head's answers to the views `index`, mirrored where the views are.

    The cross-entropy is linear in the label, so this is the weighted sum of learning from either.
    """
    clearance, dynamic, rays = (
        part[index].astype(np.float32) for part in (teacher.clearance, teacher.dynamic, teacher.rays)
    )
    clearance[mirrored], dynamic[mirrored] = clearance[mirrored][:, [0, 2, 1]], dynamic[mirrored][:, [0, 2, 1]]
    rays[mirrored] = rays[mirrored][:, ::-1]

    def mixed(true: torch.Tensor, said: np.ndarray) -> torch.Tensor:
        return torch.lerp(true, torch.from_numpy(said), TEACHER_SHARE)

    return replace(
        batch,
        clearance=mixed(batch.clearance, clearance),
        dynamic=mixed(batch.dynamic, dynamic),
        rays=mixed(batch.rays, rays),
    )


def augment_images(images: torch.Tensor) -> torch.Tensor:
    """Pictures `(B, px, px, 3)` with a random brightness, tint and noise each, by torch's random numbers."""
    count = len(images)
    tint = GAIN_SPREAD * (torch.randn(count, 1, 1, 1) + 0.5 * torch.randn(count, 1, 1, 3))
    noise = NOISE_LEVELS * torch.rand(count, 1, 1, 1) * torch.randn(images.shape)
    return (images * tint.exp() + noise).clamp(0, 255)
