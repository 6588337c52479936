"""The contrast of Algorithm 1, lines 10 to 18: masked pictures, and the rewards that change by what is hidden."""

import itertools
from collections.abc import Iterable

import numpy as np
import torch

from zsdist.vision.encoders.base import Encoder
from zsdist.vision.labels import progress, random_goals
from zsdist.vision.masks import BACKGROUND_WEIGHT, MaskedExamples, MaskedView, changed, hide, rewards
from zsdist.vision.models.head import ACTIONS, VisualActHead
from zsdist.vision.models.projection import Projection, attended_embeddings
from zsdist.vision.training.examples import Examples
from zsdist.vision.training.losses import Form, contrastive_loss

BATCH = 32  # originals a step, each with all its masked pictures
EMPTY_WEIGHT = 1.0  # of actions in whose way nothing stands, `losses.contrastive_loss`
_AT_ONCE = 256  # pictures projected at a time


class Contrast:
    """Originals and their masked pictures under a frozen projection; gives L_c of a random batch of them.

    Args:
        projection: from tokens to text space; it is not trained.
        originals: the pictures as they are, with their truth.
        masked: their masked versions.
        form: of the samples of `losses.contrastive_loss`.
        batch: originals in a batch.
    """

    def __init__(
        self,
        projection: Projection,
        originals: Examples,
        masked: MaskedExamples,
        form: Form = "difference",
        batch: int = BATCH,
    ) -> None:
        self._projection, self._originals, self._masked = projection.eval(), originals, masked
        self._form, self._batch = form, batch
        self._whole = self._embed(originals.tokens)
        self._parts = self._embed(masked.tokens)
        self._with_masks, counts = np.unique(masked.image, return_counts=True)
        # row k: the masked pictures of the k-th original that has some, filled up with -1
        self._rows = np.full((len(counts), counts.max(initial=0)), -1)
        order, first = np.argsort(masked.image, kind="stable"), np.cumsum(counts) - counts
        for row, start, count in zip(self._rows, first, counts, strict=True):
            row[:count] = order[start : start + count]

    def loss(self, head: VisualActHead, rng: np.random.Generator) -> torch.Tensor:
        """L_c of a batch of originals, drawn with new goals; a half of them mirrored. A scalar with a gradient."""
        chosen = rng.choice(len(self._rows), min(self._batch, len(self._rows)), replace=False)
        images, rows = self._with_masks[chosen], self._rows[chosen]
        positive, present = self.samples(images, rows, *random_goals(len(images), rng))
        tokens = self._originals.tokens[images].astype(np.float32)
        mirrored = rng.random(len(images)) < 0.5
        tokens[mirrored] = tokens[mirrored][:, :, ::-1]
        positive[mirrored] = positive[mirrored][:, [0, 2, 1]]
        tokens, positive = torch.from_numpy(tokens), torch.from_numpy(positive)
        with torch.no_grad():
            projected = self._projection(tokens)
        anchors = attended_embeddings(projected, head(tokens).attention)
        negative = ~positive & torch.from_numpy(present)[:, None]
        weight = np.where(self._masked.background[rows], BACKGROUND_WEIGHT, 1.0).astype(np.float32)
        return contrastive_loss(
            anchors,
            self._whole[torch.from_numpy(images)],
            self._parts[torch.from_numpy(rows)],
            positive,
            negative,
            torch.from_numpy(weight),
            self._form,
            empty_weight=EMPTY_WEIGHT,
        )

    def samples(
        self, images: np.ndarray, rows: np.ndarray, bearing_rad: np.ndarray, goal_distance_m: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """For which actions each masked picture is a positive sample `(B, 3, M)`, and which are there `(B, M)`.

        Args:
            images: `(B,)` originals.
            rows: `(B, M)` their masked pictures, -1 where there is none.
            bearing_rad: `(B,)` of a goal for each original, the same for its masked pictures.
            goal_distance_m: `(B,)`.
        """
        count = rows.shape[1]
        gain = progress(bearing_rad, goal_distance_m)
        angles = self._originals.ray_angles_rad
        whole = rewards(
            self._originals.ray_distance_m[images], self._originals.ray_dynamic[images], angles, gain, goal_distance_m
        )
        parts = rewards(
            self._masked.ray_distance_m[rows].reshape(-1, len(angles)),
            self._masked.ray_dynamic[rows].reshape(-1, len(angles)),
            angles,
            gain.repeat(count, 0),
            goal_distance_m.repeat(count),
        ).reshape(-1, count, ACTIONS)
        present = rows >= 0
        return (changed(parts, whole[:, None]) & present[..., None]).transpose(0, 2, 1), present

    def _embed(self, tokens: np.ndarray) -> torch.Tensor:
        """Means of the projected tokens, `(N, D)`, not normalised."""
        parts = []
        with torch.no_grad():
            for start in range(0, len(tokens), _AT_ONCE):
                batch = torch.from_numpy(tokens[start : start + _AT_ONCE].astype(np.float32))
                parts.append(self._projection(batch).mean((1, 2)))
        return torch.cat(parts)


def encode(
    views: Iterable[MaskedView], encoder: Encoder, ray_angles_rad: np.ndarray, at_once: int = 4
) -> tuple[Examples, MaskedExamples]:
    """Encodes pictures and their masked versions, `at_once` pictures with all their masks at a time; none are kept."""
    tokens, truth, masked_tokens, masked_truth, image, background = [], [], [], [], [], []
    views = iter(views)
    while batch := list(itertools.islice(views, at_once)):
        pictures = [view.image for view in batch]
        for view in batch:
            pictures += [hide(view.image, mask.hidden) for mask in view.masks]
            image += [len(truth)] * len(view.masks)
            background += [mask.background for mask in view.masks]
            masked_truth += [(mask.ray_distance_m, mask.ray_dynamic) for mask in view.masks]
            truth.append((view.ray_distance_m, view.ray_dynamic))
        found = encoder.tokens(np.stack(pictures)).astype(np.float16)
        tokens.append(found[: len(batch)])
        masked_tokens.append(found[len(batch) :])
    if not background:
        raise ValueError("there is no masked picture among the views; allowed is one or more")
    distance, dynamic = (np.stack(part) for part in zip(*truth, strict=True))
    masked_distance, masked_dynamic = (np.stack(part) for part in zip(*masked_truth, strict=True))
    return (
        Examples(np.concatenate(tokens), distance, dynamic, ray_angles_rad),
        MaskedExamples(
            np.concatenate(masked_tokens), np.array(image), masked_distance, masked_dynamic, np.array(background)
        ),
    )
