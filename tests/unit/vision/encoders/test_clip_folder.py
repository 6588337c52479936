import json
import socket
import subprocess
import sys

import clip_models
import numpy as np
import open_clip
import pytest
import torch
from clip_models import MAKERS, PATCH, PX, SHARDED
from safetensors.torch import load_file, save_file

from zsdist.errors import WeightsError
from zsdist.vision.encoders import open_encoder
from zsdist.vision.encoders.base import similarity
from zsdist.vision.encoders.clip_folder import ClipFolder
from zsdist.vision.exported import files_sha256

SIDE = PX // PATCH
TEXTS = ["a tree", "A rock.", "", "a tree, a rock, a tree, a rock, a tree", "zebra"]
BOTH = pytest.mark.parametrize("layout", MAKERS)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a folder and its model for each layout."""
    found = {}
    for name, make in MAKERS.items():
        folder = tmp_path_factory.mktemp(name)
        found[name] = (folder, make(folder))
    return found


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("ZSDIST_CACHE", str(tmp_path_factory.getbasetemp() / "clip-cache"))


@pytest.fixture(autouse=True)
def no_network(monkeypatch):
    def refuse(*_):
        raise AssertionError("a connection was tried")

    monkeypatch.setattr(socket.socket, "connect", refuse)


def images(count=3):
    return np.random.default_rng(2).integers(0, 256, (count, PX, PX, 3), np.uint8)


@BOTH
def test_tokens_are_the_patches_of_the_librarys_own_forward(made, layout):
    folder, model = made[layout]
    encoder = open_encoder(str(folder))
    tokens = encoder.tokens(images())
    assert tokens.shape == (3, SIDE, SIDE, 32) and tokens.dtype == np.float32
    assert (encoder.side, encoder.features, encoder.input_px) == (SIDE, 32, PX)
    np.testing.assert_allclose(tokens, clip_models.library_tokens(model, images()), atol=1e-4)


@BOTH
def test_eq01_both_towers_give_unit_vectors_of_one_space_like_the_library(made, layout):
    folder, model = made[layout]
    encoder = ClipFolder(folder)
    pictures, texts = encoder.embed_images(images()), encoder.embed_texts(TEXTS)
    np.testing.assert_allclose(np.linalg.norm(np.concatenate([pictures, texts]), axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(pictures, clip_models.library_images(model, images()), atol=1e-4)
    np.testing.assert_allclose(texts, clip_models.library_texts(model, TEXTS), atol=1e-4)
    assert similarity(pictures, texts).shape == (3, len(TEXTS))


@BOTH
def test_texts_alone_and_among_longer_ones_have_the_same_embedding(made, layout):
    encoder = ClipFolder(made[layout][0])
    np.testing.assert_allclose(encoder.embed_texts(TEXTS)[:1], encoder.embed_texts(TEXTS[:1]), atol=1e-5)


@BOTH
@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, SIDE - 1), (SIDE - 1, 0), (1, 1)])
def test_what_changes_in_a_patch_changes_its_token_most(made, layout, row, column):
    encoder = ClipFolder(made[layout][0])
    changed = images(1)
    rows, columns = (slice(PATCH * place, PATCH * (place + 1)) for place in (row, column))
    changed[:, rows, columns] = 255 - changed[:, rows, columns]
    difference = np.abs(encoder.tokens(changed) - encoder.tokens(images(1))).sum(-1)[0]
    assert np.unravel_index(difference.argmax(), difference.shape) == (row, column)


@BOTH
def test_the_native_projection_maps_like_the_library(made, layout):
    folder, model = made[layout]
    native = ClipFolder(folder).native_projection()
    tokens = torch.from_numpy(clip_models.library_tokens(model, images()))
    with torch.no_grad():
        mapped = tokens @ model.visual.proj if layout == "open_clip" else model.visual_projection(tokens)
    assert native["weight"].shape == (clip_models.DIMENSIONS, 32) and not native["bias"].any()
    np.testing.assert_allclose(tokens.numpy() @ native["weight"].T + native["bias"], mapped.numpy(), atol=1e-5)


@pytest.mark.parametrize(
    ("layout", "changes"),
    [
        ("huggingface", {"hidden_act": "gelu"}),
        ("huggingface", {"layer_norm_eps": 0.1}),
        ("open_clip", {"mlp_ratio": 2.0}),
        ("open_clip", {"quick_gelu": True}),
    ],
)
def test_settings_of_a_tower_are_followed(tmp_path, layout, changes):
    model = MAKERS[layout](tmp_path, **changes)
    tokens = ClipFolder(tmp_path).tokens(images())
    np.testing.assert_allclose(tokens, clip_models.library_tokens(model, images()), atol=1e-4)


def test_open_clips_class_with_separate_towers_is_read(tmp_path):
    model = clip_models.of_open_clip(tmp_path, separate=True)
    texts = ClipFolder(tmp_path).embed_texts(TEXTS)
    np.testing.assert_allclose(texts, clip_models.library_texts(model, TEXTS), atol=1e-4)


@pytest.mark.parametrize("make", [clip_models.transformers_5, SHARDED])
def test_what_transformers_5_saves_is_read_whole_and_in_shards(tmp_path, make):
    model = make(tmp_path)
    shards = len(list(tmp_path.glob("*.safetensors")))
    assert (shards > 2) == (make is SHARDED) and not (tmp_path / "preprocessor_config.json").exists()
    encoder = ClipFolder(tmp_path)
    np.testing.assert_allclose(encoder.tokens(images()), clip_models.library_tokens(model, images()), atol=1e-4)
    np.testing.assert_allclose(encoder.embed_images(images()), clip_models.library_images(model, images()), atol=1e-4)
    np.testing.assert_allclose(encoder.embed_texts(TEXTS), clip_models.library_texts(model, TEXTS), atol=1e-4)


def test_shards_have_a_hash_that_each_of_them_changes(tmp_path):
    SHARDED(tmp_path)
    hashes = {ClipFolder(tmp_path).sha256}
    shards = sorted(tmp_path.glob("*.safetensors"))
    for shard in shards:
        tensors = load_file(shard)
        save_file(tensors | {name: tensor + 1 for name, tensor in tensors.items()}, shard)
        hashes.add(files_sha256(shards))
    assert len(hashes) == len(shards) + 1


def test_the_nested_description_of_colours_wins_as_in_the_library(tmp_path):
    clip_models.transformers_5(tmp_path)
    before = ClipFolder(tmp_path).tokens(images())
    (tmp_path / "preprocessor_config.json").write_text('{"image_mean": [0, 0, 0], "image_std": [1, 1, 1]}')
    np.testing.assert_array_equal(ClipFolder(tmp_path).tokens(images()), before)
    (tmp_path / "processor_config.json").write_text('{"processor_class": "CLIPProcessor"}')  # as version 4 wrote it
    assert np.abs(ClipFolder(tmp_path).tokens(images()) - before).max() > 0.01


def test_pictures_that_are_not_normalised_are_scaled_alone_and_another_scale_is_refused(tmp_path):
    clip_models.transformers_5(tmp_path)
    path = tmp_path / "processor_config.json"
    about = json.loads(path.read_text())
    about["image_processor"] |= {"do_normalize": False}
    path.write_text(json.dumps(about))
    plain = ClipFolder(tmp_path).tokens(images())
    about["image_processor"] |= {"do_normalize": True, "image_mean": [0.0] * 3, "image_std": [1.0] * 3}
    path.write_text(json.dumps(about))
    np.testing.assert_array_equal(ClipFolder(tmp_path).tokens(images()), plain)
    about["image_processor"] |= {"rescale_factor": 1 / 127.5}
    path.write_text(json.dumps(about))
    with pytest.raises(WeightsError, match=r"processor_config\.json: rescale_factor is 0\.00784"):
        ClipFolder(tmp_path)


def test_the_standard_vocabulary_needs_no_file_in_the_folder(tmp_path):
    model = clip_models.of_open_clip(tmp_path, standard_tokenizer=True)
    texts = ["an oak's 3 branches, on SAND", "déjà vu in München", "a  \n sand_pile!!", "many words " * 20]
    words = open_clip.SimpleTokenizer(context_length=clip_models.CONTEXT)
    found = ClipFolder(tmp_path).embed_texts(texts)
    np.testing.assert_allclose(found, clip_models.library_texts(model, texts, words), atol=1e-4)


def test_vocabulary_and_merges_replace_a_tokenizer_file(tmp_path):
    model = clip_models.hugging_face(tmp_path)
    (tmp_path / "tokenizer.json").unlink()
    (tmp_path / "vocab.json").write_text(json.dumps(clip_models.vocabulary()))
    pairs = "".join(f"{first} {second}\n" for first, second in clip_models.PAIRS)
    (tmp_path / "merges.txt").write_text("#version: 0.2\n" + pairs)
    texts = ClipFolder(tmp_path).embed_texts(TEXTS)
    np.testing.assert_allclose(texts, clip_models.library_texts(model, TEXTS), atol=1e-4)


@BOTH
def test_weights_of_half_precision_are_read(made, layout, tmp_path):
    folder, _ = made[layout]
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (weights,) = tmp_path.glob("*.safetensors")
    save_file({name: tensor.bfloat16() for name, tensor in load_file(weights).items()}, weights)
    half, whole = ClipFolder(tmp_path), ClipFolder(folder)
    assert half.sha256 != whole.sha256
    assert np.corrcoef(half.tokens(images()).ravel(), whole.tokens(images()).ravel())[0, 1] > 0.99
    assert half.native_projection()["weight"].dtype == np.float32


@BOTH
def test_a_folder_without_a_tokenizer_gives_tokens_and_refuses_texts(tmp_path, layout):
    MAKERS[layout](tmp_path)
    (tmp_path / "tokenizer.json").unlink()
    encoder = ClipFolder(tmp_path)
    assert encoder.tokens(images()).shape == (3, SIDE, SIDE, 32)
    with pytest.raises(WeightsError, match=r"lacks a tokenizer.*tokenizer\.json, or vocab\.json with merges\.txt"):
        encoder.embed_texts(["a tree"])


@BOTH
def test_truncated_weights_are_named(tmp_path, layout):
    MAKERS[layout](tmp_path)
    (weights,) = tmp_path.glob("*.safetensors")
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(WeightsError, match=rf"{weights.name} are damaged") as refusal:
        ClipFolder(tmp_path)
    assert "\n" not in str(refusal.value)


@BOTH
def test_weights_of_another_model_are_refused(tmp_path, layout):
    MAKERS[layout](tmp_path)
    (weights,) = tmp_path.glob("*.safetensors")
    save_file(
        {name: tensor for name, tensor in load_file(weights).items() if "norm1" not in name and "ln_1" not in name},
        weights,
    )
    with pytest.raises(WeightsError, match=r"do not fit their configuration.*layer_norm1"):
        ClipFolder(tmp_path)


def test_the_name_is_that_of_the_folder_and_another_mean_gives_another_network(tmp_path):
    clip_models.hugging_face(tmp_path)
    before = ClipFolder(tmp_path)
    assert before.name == f"clip/{tmp_path.name}" and len(before.sha256) == 64
    path = tmp_path / "preprocessor_config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"image_mean": [0.0, 0.0, 0.0]}))
    assert np.abs(ClipFolder(tmp_path).tokens(images()) - before.tokens(images())).max() > 0.01


@BOTH
def test_built_towers_need_no_torch_and_no_other_model_library(made, layout):
    folder, _ = made[layout]
    ClipFolder(folder).embed_texts(["a tree"])
    code = (
        "import sys, numpy; from zsdist.vision.encoders import open_encoder; "
        f"encoder = open_encoder({str(folder)!r}); encoder.embed_texts(['a tree']); "
        f"encoder.tokens(numpy.zeros((1, {PX}, {PX}, 3), numpy.uint8)); "
        "print({'torch', 'transformers', 'open_clip', 'torchvision'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
