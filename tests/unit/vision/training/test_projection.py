import numpy as np
import pytest
import torch

from zsdist.vision.models.projection import image_embedding
from zsdist.vision.training.projection import WordExamples, WordRecipe, new_projection, train
from zsdist.vision.words.measures import naming_accuracy
from zsdist.vision.words.vocabulary import CONCEPTS, KIND_WORDS, Vocabulary, shipped_words

FEATURES, WIDTH, SIDE = 20, 32, 7
KINDS = len(KIND_WORDS)


@pytest.fixture(scope="module")
def vocabulary():
    """Return a vocabulary in which the words of one concept are close together."""
    rng, words = np.random.default_rng(3), shipped_words()
    centre = dict(zip(CONCEPTS, rng.standard_normal((len(CONCEPTS), WIDTH)), strict=True))
    rows = []
    for word in words:
        concept = next((n for n, kind in KIND_WORDS.items() if word in kind.training), "sky")
        rows.append(centre[concept] + 0.5 * rng.standard_normal(WIDTH))
    rows = np.array(rows, np.float32)
    return Vocabulary(words, rows / np.linalg.norm(rows, axis=1, keepdims=True), "")


def pictures(count, seed, vocabulary):
    """Return pictures of one kind each, which fills a part of the ground; tokens encode the cells, with noise."""
    rng = np.random.default_rng(seed)
    dominant = rng.integers(KINDS, size=count)
    concepts = np.full((count, 14, 14), CONCEPTS.index("grass"))
    for i, kind in enumerate(dominant):
        row, column = rng.integers(0, 8, 2)
        concepts[i, row : row + 6, column : column + 6] = kind
    cells = np.eye(len(CONCEPTS))[concepts]
    code = np.random.default_rng(9).standard_normal((len(CONCEPTS), FEATURES))
    tokens = cells.reshape(count, SIDE, 2, SIDE, 2, -1).mean((2, 4)) @ code
    tokens += 0.2 * rng.standard_normal(tokens.shape)
    captions = vocabulary.rows([KIND_WORDS[CONCEPTS[kind]].training[0] for kind in dominant])
    ground = np.full(count, CONCEPTS.index("grass"))
    return WordExamples(tokens.astype(np.float16), cells.astype(np.float16), captions, dominant, ground)


def named(projection, examples, vocabulary, **options):
    with torch.no_grad():
        images = image_embedding(projection(torch.from_numpy(examples.tokens.astype(np.float32)))).numpy()
        words = {
            kind: projection.texts(torch.from_numpy(vocabulary.rows(words.training))).numpy()
            for kind, words in KIND_WORDS.items()
        }
    return naming_accuracy(images, examples.dominant, words, np.random.default_rng(0), **options)["accuracy"]


@pytest.fixture(scope="module")
def data(vocabulary):
    return pictures(400, 0, vocabulary), pictures(100, 1, vocabulary)


def trained(data, vocabulary, **options):
    examples, validation = data
    projection = new_projection(examples, 0)
    recipe = WordRecipe(**{"epochs": 8, "learning_rate": 5e-3, **options})
    figures = list(train(projection, examples, validation, vocabulary, recipe, np.random.default_rng(0), lambda: 0.0))
    return projection.eval(), figures


def test_training_moves_pictures_towards_their_words(data, vocabulary):
    projection, figures = trained(data, vocabulary)
    assert named(new_projection(data[0], 0).eval(), data[1], vocabulary) < 0.5
    assert named(projection, data[1], vocabulary) > 0.9
    assert figures[-1]["validation_loss"] < 0.6 * figures[0]["validation_loss"]
    assert {"loss_captions", "loss_kinds", "loss_cells"} <= set(figures[0])


def test_tokens_that_show_a_kind_come_nearer_to_its_word_than_those_that_do_not(data, vocabulary):
    projection, _ = trained(data, vocabulary)
    examples, nearer = data[1], []
    with torch.no_grad():
        projected = projection(torch.from_numpy(examples.tokens.astype(np.float32)))
        for i, kind in enumerate(examples.dominant):
            word = projection.texts(torch.from_numpy(vocabulary[KIND_WORDS[CONCEPTS[kind]].training[0]][None]))[0]
            shown = examples.cells[i, ..., kind].reshape(SIDE, 2, SIDE, 2).mean((1, 3))
            found = torch.nn.functional.cosine_similarity(projected[i], word, dim=-1).numpy()
            nearer.append(found[shown > 0.9].mean() > found[shown < 0.1].max())
    assert np.mean(nearer) > 0.9


def test_pictures_and_words_of_excluded_kinds_are_not_trained_on(data, vocabulary):
    excluded = ("tree", "rock")
    kept = data[0].excluding(excluded)
    columns = [CONCEPTS.index(kind) for kind in excluded]
    assert 0 < len(kept) < len(data[0]) and not np.isin(kept.dominant, columns).any()
    projection, _ = trained(data, vocabulary, exclude_kinds=excluded)
    assert named(projection, data[1], vocabulary, of_kinds=excluded) < 0.5
    assert named(projection, data[1], vocabulary, of_kinds=["car", "person"]) > 0.6


def test_the_same_seed_trains_the_same_projection(data, vocabulary):
    (one, _), (other, _) = (trained(data, vocabulary, epochs=1) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(one.state_dict().values(), other.state_dict().values(), strict=True))
