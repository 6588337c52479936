import math

import numpy as np
import pytest

from zsdist.vision.words.measures import LEFT_OUT, naming_accuracy, words_of_kinds
from zsdist.vision.words.vocabulary import CONCEPTS, KIND_WORDS

KINDS = list(KIND_WORDS)
BASIS = np.eye(len(KINDS), dtype=np.float32)
WORDS = {kind: np.repeat(BASIS[i : i + 1], 2, 0) for i, kind in enumerate(KINDS)}


def accuracy(images, dominant, **options):
    return naming_accuracy(images, np.array(dominant), WORDS, np.random.default_rng(0), **options)


def test_pictures_at_the_words_of_their_kind_are_named_right_and_at_those_of_another_wrong():
    dominant = np.arange(len(KINDS))
    assert accuracy(BASIS, dominant)["accuracy"] == 1.0
    assert accuracy(np.roll(BASIS, 1, 0), dominant)["accuracy"] <= 0.35  # its own word wins some ties


def test_random_embeddings_are_named_by_chance():
    images = np.random.default_rng(1).standard_normal((1500, len(KINDS)))
    found = accuracy(images, np.random.default_rng(2).integers(len(KINDS), size=1500))
    assert found["accuracy"] == pytest.approx(1 / 6, abs=0.04) and found["images"] == 1500


def test_pictures_of_no_kind_and_of_kinds_not_tested_do_not_count():
    found = accuracy(BASIS[[0, 1, 2]], [0, -1, 0], of_kinds=[KINDS[0]])
    assert found["images"] == 2 and set(found) == {"accuracy", "images", KINDS[0]}
    assert math.isnan(accuracy(BASIS[:1], [-1])["accuracy"])


def test_fewer_than_six_kinds_are_refused():
    with pytest.raises(ValueError, match="of 5 kinds"):
        naming_accuracy(BASIS, np.arange(8), dict(list(WORDS.items())[:5]), np.random.default_rng(0))


def test_each_kind_is_left_out_once():
    assert sorted(kind for kinds in LEFT_OUT for kind in kinds) == sorted(KINDS)
    assert [CONCEPTS.index(kind) for kind in KINDS] == list(range(8))
    assert words_of_kinds("test")["tree"] == KIND_WORDS["tree"].test
