"""How well pictures are named: accuracy among six words, of which one is for what the picture is of."""

from collections.abc import Mapping, Sequence

import numpy as np

from zsdist.vision.encoders.base import similarity
from zsdist.vision.words.vocabulary import CONCEPTS, KIND_WORDS

CHOICES = 6
LEFT_OUT = (("tree", "rock"), ("person", "box"), ("sand_pile", "pole"), ("bush", "car"))
"""Kinds that are left out of training together, so that each kind is new to one projection of four."""


def naming_accuracy(
    images: np.ndarray,
    dominant: np.ndarray,
    words: Mapping[str, np.ndarray],
    rng: np.random.Generator,
    of_kinds: Sequence[str] | None = None,
) -> dict[str, float]:
    """Share of right answers to "which of these six words is the picture nearest to?"; chance is 1/6.

    A picture is asked about once for each word of its kind. The other five are drawn: one word each of five other
    kinds. That tests words never seen, with `words` of the vocabulary's test lists; words seen, with the training
    lists; and kinds never seen, with `of_kinds` those that the projection was trained without.

    Args:
        images: `(N, D)` embeddings I_0.
        dominant: `(N,)` index in `CONCEPTS` of the kind each picture is of; of none (-1), it is not asked about.
        words: of each of six kinds or more `(n, D)`, in the common space (`Projection.texts`).
        rng: draws the other words.
        of_kinds: kinds whose pictures are asked about; None: all of `words`.

    Returns:
        "accuracy" (NaN without a picture), "images", and the accuracy of each kind that has pictures.

    Raises:
        ValueError: fewer than six kinds have words.
    """
    if len(words) < CHOICES:
        raise ValueError(f"words are of {len(words)} kinds; allowed are {CHOICES} or more")
    right: dict[str, list[bool]] = {}
    names = list(words)
    for kind in of_kinds or names:
        others = [name for name in names if name != kind]
        for index in np.flatnonzero(dominant == CONCEPTS.index(kind)):
            for word in words[kind]:
                rivals = rng.choice(len(others), CHOICES - 1, replace=False)
                choices = [word] + [rng.choice(words[others[i]]) for i in rivals]
                nearest = similarity(images[index][None], np.stack(choices))[0].argmax()
                right.setdefault(kind, []).append(bool(nearest == 0))
    asked = [answer for answers in right.values() for answer in answers]
    counted = np.isin(dominant, [CONCEPTS.index(kind) for kind in right])
    return {
        "accuracy": float(np.mean(asked)) if asked else float("nan"),
        "images": int(counted.sum()),
        **{kind: float(np.mean(answers)) for kind, answers in right.items()},
    }


def words_of_kinds(use: str) -> dict[str, tuple[str, ...]]:
    """The words of each kind for a use: "training", "validation" or "test"."""
    return {kind: getattr(words, use) for kind, words in KIND_WORDS.items()}
