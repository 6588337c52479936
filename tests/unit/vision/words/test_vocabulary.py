import hashlib
import itertools
import subprocess
import sys

import numpy as np
import pytest
import safetensors.numpy

from zsdist.errors import WeightsError
from zsdist.vision.words.vocabulary import (
    CONCEPTS,
    KIND_WORDS,
    TABLE3_WORDS,
    WORDS,
    Vocabulary,
    caption,
    shipped_words,
)

SMALL = {"a", "an", "the", "of"}


def nouns(use):
    return {part for words in WORDS.values() for text in getattr(words, use) for part in text.split()} - SMALL


def test_words_for_training_validation_and_test_share_no_noun_but_sand():
    for one, other in itertools.combinations(("training", "validation", "test"), 2):
        assert nouns(one) & nouns(other) <= {"sand"}


def test_every_word_belongs_to_one_concept():
    words = [text for concept in WORDS.values() for use in concept for text in use]
    assert len(words) == len(set(words))


def test_captions_use_training_words_alone_and_say_where_and_on_what():
    rng = np.random.default_rng(0)
    held_out = [text for words in WORDS.values() for text in (*words.validation, *words.test)]
    for _ in range(300):
        kind = list(KIND_WORDS)[int(rng.integers(len(KIND_WORDS)))]
        text = caption([(kind, "left"), ("rock", "ahead")], "grass", rng)
        assert not any(f" {word} " in f" {text} " for word in held_out)
        assert any(word in text for word in KIND_WORDS[kind].training) and " left" in text
        assert any(word in text for word in ("grass", "lawn", "meadow"))
    assert caption([], "sand", np.random.default_rng(1)) == caption([], "sand", np.random.default_rng(1))


def test_shipped_words_are_those_of_training_and_of_table_3_and_none_of_the_test():
    assert set(TABLE3_WORDS) <= set(CONCEPTS) and set(TABLE3_WORDS.values()) <= set(shipped_words())
    assert set(KIND_WORDS["tree"].training) <= set(shipped_words())
    assert not {text for words in WORDS.values() for text in words.test} & set(shipped_words())


def test_a_written_vocabulary_reads_back():
    rows = np.eye(3, 5, dtype=np.float32)
    back = Vocabulary.from_bytes(Vocabulary(("a tree", "sand", "ä"), rows, "ab12").to_bytes())
    assert back.words == ("a tree", "sand", "ä") and back.text_sha256 == "ab12"
    assert (back["sand"] == rows[1]).all() and (back.rows(["ä", "a tree"]) == rows[[2, 0]]).all()


def test_equal_content_gives_equal_bytes_in_every_process():
    written = "Vocabulary(('a tree', 'sand'), np.eye(2, 3, dtype=np.float32), 'ab12').to_bytes()"
    code = (
        "import hashlib, numpy as np; from zsdist.vision.words.vocabulary import Vocabulary; "
        f"print({{hashlib.sha256({written}).hexdigest() for _ in range(20)}})"
    )
    here = {Vocabulary(("a tree", "sand"), np.eye(2, 3, dtype=np.float32), "ab12").to_bytes() for _ in range(20)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str({hashlib.sha256(content).hexdigest() for content in here}) and len(here) == 1
    assert (safetensors.numpy.load(here.pop())["embeddings"] == np.eye(2, 3)).all()


def test_a_damaged_vocabulary_and_a_missing_word_are_refused_in_one_line():
    content = Vocabulary(("a tree",), np.ones((1, 4), np.float32), "ab12").to_bytes()
    for damaged in (b"", content[:-3], content.replace(b"text_sha256", b"text_sha257")):
        with pytest.raises(WeightsError, match="vocabulary is damaged"):
            Vocabulary.from_bytes(damaged)
    with pytest.raises(WeightsError, match="1 words and embeddings"):
        Vocabulary.from_bytes(Vocabulary(("a tree",), np.ones((2, 4), np.float32), "").to_bytes())
    with pytest.raises(WeightsError, match="'an oak' is not in the vocabulary of 1 words"):
        Vocabulary.from_bytes(content)["an oak"]
