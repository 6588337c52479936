"""Attention of the head on a picture, and embeddings of the attended parts in the space of words; torch."""

import torch
from torch import Tensor, nn

from zsdist.vision.models.head import VisualActHead
from zsdist.vision.models.projection import attended_embeddings, image_embedding


class AttentionReader(nn.Module):
    """Network of head and projection, from tokens to attention and embeddings.

    Args:
        head: network that gives the attention of each action.
        projection: map of tokens `(B, side, side, features)` to the space of words, `(B, side, side, D)`.
    """

    def __init__(self, head: VisualActHead, projection: nn.Module) -> None:
        super().__init__()
        self.head = head
        self.projection = projection

    def forward(self, tokens: Tensor) -> tuple[Tensor, Tensor]:
        """Return the attention of each action `(B, 3, side * side)` and I_0 to I_3, `(B, 4, D)` of unit length."""
        weights, projected = self.head(tokens).attention, self.projection(tokens)
        whole = image_embedding(projected)[:, None]
        return weights, torch.cat([whole, attended_embeddings(projected, weights)], 1)
