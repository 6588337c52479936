"""Accuracy of naming pictures: the choice among six words, exactly one of which fits the dominant kind."""

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
    """Return the share of pictures that are nearest to the right one of six words; chance is 1/6.

    A picture is tested once with each word of its kind. The other five words are drawn, one from each of five other
    kinds. `words` from the vocabulary's test lists measure unseen words, those from the training lists seen words;
    `of_kinds` restricts the test to some kinds, such as those that the projection was trained without.

    Args:
        images: `(N, D)`, embeddings I_0 of the pictures.
        dominant: `(N,)` index in `CONCEPTS` of the dominant kind of each picture; pictures with -1 are skipped.
        words: embeddings `(n, D)` of the words of each of six kinds or more, in the common space (`Projection.texts`).
        rng: source of the other words.
        of_kinds: kinds whose pictures are tested; None: all of `words`.

    Returns:
        "accuracy" (NaN without pictures), "images", and the accuracy of each kind that has pictures.

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
    """Return the words of each kind for a use: "training", "validation" or "test"."""
    return {kind: getattr(words, use) for kind, words in KIND_WORDS.items()}
