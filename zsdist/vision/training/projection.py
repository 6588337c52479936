"""Training of the projection to the space of words, on captioned pictures whose tokens are computed once; torch.

There are three losses, all cross-entropies of cosines over a temperature:

* captions: within a batch, each picture is matched to its caption and each caption to its picture, as in CLIP;
* kinds: a picture is matched to its dominant kind, among words drawn for each batch, one per concept;
* cells: some cells of a picture are matched to the concepts that they show, in the same way.

Words are drawn at random and with noise, so that the direction of a concept is learned and not that of a single word.
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

CELLS_A_PICTURE = 24  # cells drawn per picture; rare concepts are drawn as often as sky and ground


@dataclass(frozen=True)
class WordExamples:
    """Encoded pictures with their contents; `side` is the encoder's number of tokens along a side.

    Attributes:
        tokens: `(N, side, side, features)` float16, tokens of the pictures.
        cells: `(N, 14, 14, C)` float16, shares of `vocabulary.CONCEPTS` in each cell, `CaptionedView.cells`.
        captions: `(N, D)` float16, `Encoder.embed_texts` of the captions.
        dominant: `(N,)` int64, index of the dominant kind; -1: none.
        ground: `(N,)` int64, index of the concept of the ground.
    """

    tokens: np.ndarray
    cells: np.ndarray
    captions: np.ndarray
    dominant: np.ndarray
    ground: np.ndarray

    def __len__(self) -> int:
        return len(self.tokens)

    def excluding(self, kinds: tuple[str, ...]) -> "WordExamples":
        """Return the pictures that show none of these kinds in any cell."""
        columns = [CONCEPTS.index(kind) for kind in kinds]
        keep = ~(self.cells[..., columns] > 0).any((1, 2, 3))
        return WordExamples(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class WordRecipe(Recipe):
    """Settings of the training of a projection.

    Attributes:
        temperature: divisor of the cosines.
        captions, kinds, cells: weights of the three losses.
        word_noise: length of the noise on a drawn word, whose own length is 1.
        exclude_kinds: kinds that are excluded from the training, both pictures and words; used to measure how well
            words of untrained kinds are understood.
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
    """Return a projection with random weights; it normalises tokens with the mean and spread of `examples`."""
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
    """Return a trainer of `projection`. Each `next` is one epoch; the end loads the best weights on `validation`.

    In each epoch half of the pictures are mirrored; their captions are left out, since they name left and right.

    Args:
        projection: projection from `new_projection`; trained in place.
        examples: training pictures.
        validation: pictures of scenes that are not among `examples`.
        vocabulary: vocabulary with all training words.
        recipe: settings of the training.
        rng: source of orders, mirrors, words and cells.
        time_used: function that returns the used share of the time budget.
    """
    examples, validation = examples.excluding(recipe.exclude_kinds), validation.excluding(recipe.exclude_kinds)
    words = _Words(vocabulary, recipe)

    def losses(rng: np.random.Generator) -> Losses:
        order = rng.permutation(len(examples))
        for start in range(0, len(order), recipe.batch):
            yield _loss(projection, examples, order[start : start + recipe.batch], words, recipe, rng, mirror=True)

    def validate() -> dict[str, float]:
        projection.eval()
        fixed = np.random.default_rng(0)
        sums: dict[str, float] = {}
        with torch.no_grad():
            for start in range(0, len(validation), recipe.batch):
                index = np.arange(start, min(start + recipe.batch, len(validation)))
                _, parts = _loss(projection, validation, index, words, recipe, fixed, mirror=False)
                for name, value in parts.items():
                    sums[name] = sums.get(name, 0.0) + value * len(index)
        return {name: value / len(validation) for name, value in sums.items()}

    return Trainer(projection, recipe, math.ceil(len(examples) / recipe.batch), losses, validate, rng, time_used)


class _Words:
    """Sampler of training words, one for each concept, with noise."""

    def __init__(self, vocabulary: Vocabulary, recipe: WordRecipe) -> None:
        self._embeddings = [
            vocabulary.rows(WORDS[name].training) for name in CONCEPTS if name not in recipe.exclude_kinds
        ]
        self._noise = recipe.word_noise
        self.columns = [i for i, name in enumerate(CONCEPTS) if name not in recipe.exclude_kinds]

    def draw(self, rng: np.random.Generator) -> Tensor:
        """Return the embedding of one random word for each learned concept, `(concepts, D)`."""
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
    """Return the loss of the pictures `index`, and its parts."""
    mirrored = rng.random(len(index)) < 0.5 if mirror else np.zeros(len(index), bool)
    tokens = _mirror(examples.tokens[index], mirrored)
    side = tokens.shape[1]
    cells = _at_side(_mirror(examples.cells[index][..., words.columns], mirrored), side)
    hidden = projection.hidden(tokens)
    image = image_embedding(projection.leave(hidden.mean((1, 2), keepdim=True)))  # the last map is linear
    concepts = projection.texts(words.draw(rng))
    parts: dict[str, Tensor] = {}
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
    total = sum(parts.values(), torch.zeros(()))
    return total, {name: float(part.detach()) for name, part in parts.items()}


def _mirror(values: np.ndarray, mirrored: np.ndarray) -> Tensor:
    """Return `(B, side, side, ...)` as float32, with left and right swapped where `mirrored` `(B,)` is true."""
    result = values.astype(np.float32)
    result[mirrored] = result[mirrored, :, ::-1]
    return torch.from_numpy(result)


def _at_side(cells: Tensor, side: int) -> Tensor:
    """Return shares `(B, 14, 14, C)` averaged to `side` x `side` cells."""
    if cells.shape[1] == side:
        return cells
    return functional.adaptive_avg_pool2d(cells.permute(0, 3, 1, 2), side).permute(0, 2, 3, 1)


def _drawn_cells(shares: Tensor, count: int, rng: np.random.Generator) -> Tensor:
    """Return indices `(count,)` of cells `(cells, C)`, drawn so that all concepts present are equally likely."""
    concept = shares.argmax(-1)
    counts = torch.bincount(concept, minlength=shares.shape[1]).double()
    weights = (1 / counts)[concept].numpy()
    return torch.from_numpy(rng.choice(len(weights), count, p=weights / weights.sum()))
