"""Training of the projection to the space of words, on described pictures whose tokens are computed once; torch.

Three losses, all of them cross-entropies of cosines over a temperature:

* captions: of a batch, each picture finds its own caption and each caption its own picture, as CLIP learns;
* kinds: a picture finds the kind that dominates it among words drawn anew for each batch, one for each concept;
* cells: so does each of some cells of the picture, by what it shows.

That a word is drawn, and some noise on it, makes the direction of a concept be learned rather than that of a word.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from zsdist.vision.models.projection import Projection, image_embedding
from zsdist.vision.training.examples import token_spread
from zsdist.vision.training.trainer import Losses, Recipe, Trainer
from zsdist.vision.words.vocabulary import CONCEPTS, KIND_WORDS, WORDS, Vocabulary

CELLS_A_PICTURE = 24  # drawn, so that what is seldom seen is drawn as often as sky and ground


@dataclass(frozen=True)
class WordExamples:
    """Encoded pictures with what they show; `side` is that of the encoder's tokens.

    Attributes:
        tokens: `(N, side, side, features)` float16.
        cells: `(N, 14, 14, C)` float16, shares of `vocabulary.CONCEPTS` in each cell, `DescribedView.cells`.
        captions: `(N, D)` float16, `Encoder.embed_texts` of the captions.
        dominant: `(N,)` int64, index of the kind the picture is of; -1: of none.
        ground: `(N,)` int64, index of the concept that the ground is.
    """

    tokens: np.ndarray
    cells: np.ndarray
    captions: np.ndarray
    dominant: np.ndarray
    ground: np.ndarray

    def __len__(self) -> int:
        return len(self.tokens)

    def excluding(self, kinds: tuple[str, ...]) -> "WordExamples":
        """The pictures in which none of these kinds is to be seen in any cell."""
        columns = [CONCEPTS.index(kind) for kind in kinds]
        keep = ~(self.cells[..., columns] > 0).any((1, 2, 3))
        return WordExamples(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class WordRecipe(Recipe):
    """How to train a projection.

    Attributes:
        temperature: of the cosines.
        captions, kinds, cells: weights of the three losses.
        word_noise: length of the noise on a drawn word, whose own length is 1.
        exclude_kinds: kinds of which nothing is learned, neither from pictures nor as words: to measure how much of
            the understanding of words is for the kinds that were trained.
    """

    epochs: int = 10
    batch: int = 64
    learning_rate: float = 2e-3
    temperature: float = 0.07
    captions: float = 0.5
    kinds: float = 1.0
    cells: float = 1.0
    word_noise: float = 1.0
    exclude_kinds: tuple[str, ...] = field(default=())


def new_projection(examples: WordExamples, seed: int) -> Projection:
    """A projection with random weights that expects tokens of the mean and spread of `examples`."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        projection = Projection(examples.tokens.shape[-1], examples.captions.shape[-1])
    projection.normalise_to(*token_spread(examples.tokens))
    return projection


def train(
    projection: Projection,
    examples: WordExamples,
    validation: WordExamples,
    vocabulary: Vocabulary,
    recipe: WordRecipe,
    rng: np.random.Generator,
    time_used: Callable[[], float],
) -> Trainer:
    """Trains `projection` in place, an epoch each `next`; ends with the weights of the best epoch on `validation`.

    Half of the pictures come mirrored in each epoch; their captions then stand aside, as they tell left from right.

    Args:
        projection: from `new_projection`.
        examples: to learn from.
        validation: pictures of scenes that are not among `examples`.
        vocabulary: with all training words.
        recipe: how.
        rng: decides orders, mirrors, words and cells.
        time_used: share of the time allowed that is gone.
    """
    examples, validation = examples.excluding(recipe.exclude_kinds), validation.excluding(recipe.exclude_kinds)
    words = _Words(vocabulary, recipe)

    def losses(rng: np.random.Generator) -> Losses:
        order = rng.permutation(len(examples))
        for start in range(0, len(order), recipe.batch):
            yield _loss(projection, examples, order[start : start + recipe.batch], words, recipe, rng, mirror=True)

    def validate() -> dict[str, float]:
        projection.eval()
        fixed, sums = np.random.default_rng(0), {}
        with torch.no_grad():
            for start in range(0, len(validation), recipe.batch):
                index = np.arange(start, min(start + recipe.batch, len(validation)))
                _, parts = _loss(projection, validation, index, words, recipe, fixed, mirror=False)
                for name, value in parts.items():
                    sums[name] = sums.get(name, 0.0) + value * len(index)
        return {name: value / len(validation) for name, value in sums.items()}

    return Trainer(projection, recipe, math.ceil(len(examples) / recipe.batch), losses, validate, rng, time_used)


class _Words:
    """Draws a training word for each concept, with noise."""

    def __init__(self, vocabulary: Vocabulary, recipe: WordRecipe) -> None:
        self._embeddings = [
            vocabulary.rows(WORDS[name].training) for name in CONCEPTS if name not in recipe.exclude_kinds
        ]
        self._noise = recipe.word_noise
        self.columns = [i for i, name in enumerate(CONCEPTS) if name not in recipe.exclude_kinds]

    def draw(self, rng: np.random.Generator) -> Tensor:
        """`(concepts learned, D)`."""
        chosen = np.stack([rows[int(rng.integers(len(rows)))] for rows in self._embeddings])
        noise = rng.standard_normal(chosen.shape) * self._noise / chosen.shape[1] ** 0.5
        return torch.from_numpy((chosen + noise).astype(np.float32))


def _loss(
    projection: Projection,
    examples: WordExamples,
    index: np.ndarray,
    words: _Words,
    recipe: WordRecipe,
    rng: np.random.Generator,
    mirror: bool,
) -> tuple[Tensor, dict[str, float]]:
    """The loss of the pictures `index`, and its parts."""
    mirrored = rng.random(len(index)) < 0.5 if mirror else np.zeros(len(index), bool)
    tokens = _as_seen(examples.tokens[index], mirrored)
    side = tokens.shape[1]
    cells = _at_side(_as_seen(examples.cells[index][..., words.columns], mirrored), side)
    hidden = projection.hidden(tokens)
    image = image_embedding(projection.leave(hidden.mean((1, 2), keepdim=True)))  # the last map is linear
    concepts = projection.texts(words.draw(rng))
    parts = {}
    plain = torch.from_numpy(np.flatnonzero(~mirrored))
    texts = projection.texts(torch.from_numpy(examples.captions[index].astype(np.float32)))[plain]
    logits = image[plain] @ texts.T / recipe.temperature
    own = torch.arange(len(plain))
    both = functional.cross_entropy(logits, own) + functional.cross_entropy(logits.T, own)
    parts["captions"] = recipe.captions * both / 2
    kinds = [words.columns.index(CONCEPTS.index(name)) for name in KIND_WORDS if name not in recipe.exclude_kinds]
    dominant = examples.dominant[index]
    of_a_kind = np.flatnonzero(dominant >= 0)
    if len(of_a_kind):
        true = torch.tensor([kinds.index(words.columns.index(int(kind))) for kind in dominant[of_a_kind]])
        logits = image[of_a_kind] @ concepts[kinds].T / recipe.temperature
        parts["kinds"] = recipe.kinds * functional.cross_entropy(logits, true)
    flat = cells.flatten(0, 2)
    chosen = _drawn_cells(flat, CELLS_A_PICTURE * len(index), rng)
    projected = functional.normalize(projection.leave(hidden.flatten(0, 2)[chosen]), dim=-1)
    logits = projected @ concepts.T / recipe.temperature
    parts["cells"] = recipe.cells * functional.cross_entropy(logits, flat[chosen])
    return sum(parts.values()), {name: float(part.detach()) for name, part in parts.items()}


def _as_seen(values: np.ndarray, mirrored: np.ndarray) -> Tensor:
    """`(B, side, side, ...)` as float32, with left and right changed where `mirrored` `(B,)`."""
    seen = values.astype(np.float32)
    seen[mirrored] = seen[mirrored, :, ::-1]
    return torch.from_numpy(seen)


def _at_side(cells: Tensor, side: int) -> Tensor:
    """Shares `(B, 14, 14, C)` for `side` cells to a side."""
    if cells.shape[1] == side:
        return cells
    return functional.adaptive_avg_pool2d(cells.permute(0, 3, 1, 2), side).permute(0, 2, 3, 1)


def _drawn_cells(shares: Tensor, count: int, rng: np.random.Generator) -> Tensor:
    """Indices `(count,)` of cells `(cells, C)`, drawn so that each concept that is there is as likely as the others."""
    most = shares.argmax(-1)
    often = torch.bincount(most, minlength=shares.shape[1]).double()
    weights = (1 / often)[most].numpy()
    return torch.from_numpy(rng.choice(len(weights), count, p=weights / weights.sum()))
