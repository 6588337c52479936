"""Projection of an encoder's tokens to the space that pictures share with words; torch."""

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

WIDTH = 128  # number of features of a token inside the projection


class Projection(nn.Module):
    """Projection of each token, with its neighbours, to the space of words; embeddings of texts stay unchanged.

    A trained map of texts was tried too: it brought words of the training a little nearer to their pictures, but not
    unseen words.

    Args:
        features: number of features of a token.
        text_width: D, width of the text tower's embeddings and of the common space.
    """

    mean: Tensor
    scale: Tensor

    def __init__(self, features: int, text_width: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("scale", torch.ones(features))
        self.enter = nn.Linear(features, WIDTH)
        self.around = nn.Conv2d(WIDTH, WIDTH, 3, padding=1, groups=WIDTH)
        self.mix = nn.Linear(WIDTH, WIDTH)
        self.leave = nn.Linear(WIDTH, text_width)

    def normalise_to(self, mean: np.ndarray, deviation: np.ndarray) -> None:
        """Set the mean and standard deviation `(features,)` with which tokens are normalised."""
        self.mean.copy_(torch.from_numpy(mean))
        self.scale.copy_(1 / torch.from_numpy(np.maximum(deviation, 1e-6)))

    def hidden(self, tokens: Tensor) -> Tensor:
        """Return the input of the last linear map, `(B, side, side, WIDTH)`, for tokens `(B, side, side, features)`."""
        x = torch.relu(self.enter((tokens - self.mean) * self.scale))
        x = x + self.around(x.permute(0, 3, 1, 2)).permute(0, 2, 3, 1)
        return torch.relu(x + self.mix(torch.relu(x)))

    def forward(self, tokens: Tensor) -> Tensor:
        """Return tokens `(B, side, side, features)` in the space of words, `(B, side, side, D)`; length is weight."""
        return self.leave(self.hidden(tokens))

    def texts(self, embeddings: Tensor) -> Tensor:
        """Return embeddings `(N, D)` of a text tower in the common space, `(N, D)` of unit length."""
        return functional.normalize(embeddings, dim=-1)


def image_embedding(projected: Tensor) -> Tensor:
    """Return I_0 `(B, D)` of unit length, the f(I) of Eq. (1): the mean of projected tokens `(B, side, side, D)`."""
    return functional.normalize(projected.mean((1, 2)), dim=-1)


def attended_embeddings(projected: Tensor, attention: Tensor) -> Tensor:
    """Return I_1 to I_3 `(B, 3, D)` of unit length: means of the projected tokens, weighted by each action's attention.

    Args:
        projected: `(B, side, side, D)`, projected tokens.
        attention: `(B, 3, side * side)`, attention of each action, as in `HeadOutput`.
    """
    return functional.normalize(attention @ projected.flatten(1, 2), dim=-1)


def projection_of(weights: dict[str, Tensor]) -> Projection:
    """Return the projection with these weights, which also give its sizes."""
    projection = Projection(weights["enter.weight"].shape[1], weights["leave.weight"].shape[0])
    projection.load_state_dict(weights)
    return projection.eval()
