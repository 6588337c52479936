"""Contrast of Algorithm 1, lines 10 to 18: masked pictures, and the rewards that change with the hidden object.

The attention error is computed here too, since masks also show to which tokens each action should attend.
"""

import numpy as np
import torch
from torch import nn

from zsdist.vision.labels import progress, random_goals
from zsdist.vision.masks import BACKGROUND_WEIGHT, MaskedExamples, labels_changed, rewards
from zsdist.vision.models.head import ACTIONS, VisualActHead
from zsdist.vision.models.projection import attended_embeddings
from zsdist.vision.training.examples import Examples
from zsdist.vision.training.losses import Form, attention_error, contrastive_loss

BATCH = 32  # originals per step, each with all its masked pictures
ATTENTION_WEIGHT = 5.0  # weight of the attention error, which is added to L_c
_SKY_SHARE = 0.3  # share of the uppermost row that a background must cover to count as sky
_UNTOUCHED, _TOUCHED = (
    0.27,
    0.93,
)  # shares of a token's greatest change: coverage is 0 below the first, 1 above the second
_AT_ONCE = 256  # number of pictures projected at once


class Contrast:
    """Contrastive loss of random batches of originals and their masked pictures under a frozen projection.

    Args:
        projection: trained projection or the encoder's own, from tokens to text space; it stays frozen here.
        originals: unmasked pictures with their truth.
        masked: masked versions of the originals.
        form: form of the samples in `losses.contrastive_loss`.
        batch: number of originals in a batch.
    """

    def __init__(
        self,
        projection: nn.Module,
        originals: Examples,
        masked: MaskedExamples,
        form: Form = "difference",
        batch: int = BATCH,
    ) -> None:
        self._projection, self._originals, self._masked = projection.eval(), originals, masked
        self._form, self._batch = form, batch
        self._whole = self._embed(originals.tokens)
        self._parts = self._embed(masked.tokens)
        self._coverage = mask_coverage(originals.tokens, masked)
        self._with_masks, counts = np.unique(masked.image, return_counts=True)
        # row k: the masked pictures of the k-th original that has any, padded with -1
        self._rows = np.full((len(counts), counts.max(initial=0)), -1)
        order, first = np.argsort(masked.image, kind="stable"), np.cumsum(counts) - counts
        for row, start, count in zip(self._rows, first, counts, strict=True):
            row[:count] = order[start : start + count]

    def loss(self, head: VisualActHead, rng: np.random.Generator) -> torch.Tensor:
        """Return L_c plus the weighted attention error, a scalar, with new goals and half of the originals mirrored."""
        chosen = rng.choice(len(self._rows), min(self._batch, len(self._rows)), replace=False)
        images, rows = self._with_masks[chosen], self._rows[chosen]
        is_positive, present = self.samples(images, rows, *random_goals(len(images), rng))
        original_tokens = self._originals.tokens[images].astype(np.float32)
        mirrored = rng.random(len(images)) < 0.5
        original_tokens[mirrored] = original_tokens[mirrored][:, :, ::-1]
        is_positive[mirrored] = is_positive[mirrored][:, [0, 2, 1]]
        tokens, positive = torch.from_numpy(original_tokens), torch.from_numpy(is_positive)
        with torch.no_grad():
            projected = self._projection(tokens)
        attention = head(tokens).attention
        anchors = attended_embeddings(projected, attention)
        negative = ~positive & torch.from_numpy(present)[:, None]
        weight = np.where(self._masked.background[rows], BACKGROUND_WEIGHT, 1.0).astype(np.float32)
        cover = self._coverage[rows].astype(np.float32) * present[..., None]
        cover = cover.reshape(*cover.shape[:2], *tokens.shape[1:3])
        cover[mirrored] = cover[mirrored][..., ::-1]
        wanted, unwanted = attention_targets(cover, is_positive, self._masked.background[rows] & present)
        error = attention_error(attention, torch.from_numpy(wanted), torch.from_numpy(unwanted))
        return ATTENTION_WEIGHT * error + contrastive_loss(
            anchors,
            self._whole[torch.from_numpy(images)],
            self._parts[torch.from_numpy(rows)],
            positive,
            negative,
            torch.from_numpy(weight),
            self._form,
        )

    def samples(
        self, images: np.ndarray, rows: np.ndarray, bearing_rad: np.ndarray, goal_distance_m: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the actions for which each masked picture is a positive sample, and which masked pictures exist.

        Args:
            images: `(B,)`, indices of originals.
            rows: `(B, M)`, indices of their masked pictures; -1: none.
            bearing_rad: `(B,)`, bearing of a goal for each original, the same for its masked pictures.
            goal_distance_m: `(B,)`, distance of this goal.

        Returns:
            `(B, 3, M)` bool, and `(B, M)` bool.
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
        return (labels_changed(parts, whole[:, None]) & present[..., None]).transpose(0, 2, 1), present

    def _embed(self, tokens: np.ndarray) -> torch.Tensor:
        """Return the mean of each picture's projected tokens, `(N, D)`, not normalised."""
        parts = []
        with torch.no_grad():
            for start in range(0, len(tokens), _AT_ONCE):
                batch = torch.from_numpy(tokens[start : start + _AT_ONCE].astype(np.float32))
                parts.append(self._projection(batch).mean((1, 2)))
        return torch.cat(parts)


def mask_coverage(tokens: np.ndarray, masked: MaskedExamples) -> np.ndarray:
    """Return the coverage of tokens by masks, `(M, side * side)` float16, 0 to 1, from each token's relative change.

    Args:
        tokens: `(N, side, side, F)`, tokens of the originals.
        masked: masked pictures of these originals.
    """
    scale = 1 / np.maximum(np.asarray(tokens[:256], np.float32).std((0, 1, 2)), 1e-6)
    found = np.empty((len(masked.tokens), tokens.shape[1] * tokens.shape[2]), np.float16)
    for start in range(0, len(found), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        whole = tokens[masked.image[rows]].astype(np.float32)
        change = (((masked.tokens[rows].astype(np.float32) - whole) * scale) ** 2).mean(-1) ** 0.5
        change = change.reshape(len(change), -1)
        share = change / np.maximum(change.max(1, keepdims=True), 1e-6)
        found[rows] = np.clip((share - _UNTOUCHED) / (_TOUCHED - _UNTOUCHED), 0, 1)
    return found


def attention_targets(cover: np.ndarray, positive: np.ndarray, background: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the tokens that each action should attend to, `(B, 3, T)`, and those that none should, `(B, T)`, 0 to 1.

    An action should attend to objects that change its reward; if there are none, to the sky, which resembles neither
    obstacles nor ground. No action should attend to empty ground.

    Args:
        cover: `(B, M, side, side)`, coverage of each token by each mask.
        positive: `(B, 3, M)` bool, actions for which a mask is a positive sample.
        background: `(B, M)` bool, masks of the background.
    """
    sky = background & (cover[:, :, 0].mean(-1) > _SKY_SHARE)
    below = np.arange(cover.shape[2]) >= cover.shape[2] // 2
    flat = cover.reshape(*cover.shape[:2], -1)

    def union(chosen: np.ndarray) -> np.ndarray:
        return (flat * chosen[..., None]).max(-2, initial=0.0)

    objects = union(~background)
    ground = np.clip(union(background & ~sky) - objects, 0, 1) * below.repeat(cover.shape[3])
    relevant = np.stack([union(positive[:, action]) for action in range(ACTIONS)], 1)
    nothing = ~positive.any(-1, keepdims=True)
    return np.where(nothing, np.clip(union(sky) - objects, 0, 1)[:, None], relevant), ground
