import json
import re

import clip_models
import pytest
from clip_models import ALL_MAKERS, MAKERS, SHARDED

from zsdist.errors import WeightsError
from zsdist.vision.encoders import open_encoder
from zsdist.vision.encoders.clip_folder import ClipFolder
from zsdist.vision.encoders.clip_layouts import read_folder


def test_a_shard_is_looked_for_in_the_folder_alone(tmp_path):
    SHARDED(tmp_path / "model")
    index = tmp_path / "model" / "model.safetensors.index.json"
    shard = next((tmp_path / "model").glob("model-00001-of-*"))
    shard.rename(tmp_path / shard.name)
    index.write_text(index.read_text().replace(shard.name, f"../{shard.name}"))
    with pytest.raises(WeightsError, match=rf"lacks {shard.name}"):
        ClipFolder(tmp_path / "model")


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"weight_map": []}', '{"weight_map": {"a": 3}}'])
def test_a_damaged_index_of_shards_is_named(tmp_path, text):
    SHARDED(tmp_path)
    (tmp_path / "model.safetensors.index.json").write_text(text)
    with pytest.raises(WeightsError, match=r"model\.safetensors\.index\.json (is damaged|lacks)"):
        ClipFolder(tmp_path)


@pytest.mark.parametrize("missing", ["image_mean", "image_std"])
@pytest.mark.parametrize(
    ("make", "name"),
    [(clip_models.transformers_5, "processor_config.json"), (clip_models.hugging_face, "preprocessor_config.json")],
)
def test_a_missing_mean_is_blamed_on_the_file_that_lacks_it(tmp_path, make, name, missing):
    make(tmp_path)
    about = json.loads((tmp_path / name).read_text())
    del about.get("image_processor", about)[missing]
    (tmp_path / name).write_text(json.dumps(about))
    with pytest.raises(WeightsError, match=rf"encoder configuration {tmp_path / name} lacks '{missing}'"):
        ClipFolder(tmp_path)


@pytest.mark.parametrize("towers", [{}, {"vision_config": None, "text_config": None}, {"vision_config": {}}])
def test_towers_that_a_configuration_omits_are_those_of_the_library(tmp_path, towers):
    clip_models.transformers_5(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps({"model_type": "clip", **towers}))
    pictures = json.loads((tmp_path / "processor_config.json").read_text())
    del pictures["image_processor"]["crop_size"]  # of the small model
    (tmp_path / "processor_config.json").write_text(json.dumps(pictures))
    clip, _ = read_folder(tmp_path)
    library = clip_models.default_configuration()
    for shape, config in ((clip.vision, library.vision_config), (clip.text, library.text_config)):
        assert (shape.layers, shape.width, shape.heads) == (
            config.num_hidden_layers, config.hidden_size, config.num_attention_heads
        )  # fmt: skip
        assert (shape.inner, shape.activation) == (config.intermediate_size, config.hidden_act)
        assert shape.epsilon == config.layer_norm_eps
    assert (clip.image_px, clip.patch_px) == (library.vision_config.image_size, library.vision_config.patch_size)
    assert (clip.context, clip.vocabulary) == (
        library.text_config.max_position_embeddings, library.text_config.vocab_size
    )  # fmt: skip
    assert clip.dimensions == library.projection_dim


@pytest.mark.parametrize(
    ("layout", "name"),
    [
        ("huggingface", "pytorch_model.bin"),
        ("huggingface", "pytorch_model.bin.index.json"),
        ("open_clip", "open_clip_pytorch_model.bin"),
    ],
)
def test_weights_as_pickles_are_refused_with_the_reason(tmp_path, layout, name):
    MAKERS[layout](tmp_path)
    (weights,) = tmp_path.glob("*.safetensors")
    weights.rename(tmp_path / name)
    with pytest.raises(WeightsError, match=rf"lacks {weights.name}; {name} is not read.*save the model as safetensors"):
        ClipFolder(tmp_path)


@pytest.mark.parametrize(
    ("layout", "missing"),
    [
        ("open_clip", "open_clip_config.json"),
        ("open_clip", "open_clip_model.safetensors"),
        ("huggingface", "config.json"),
        ("huggingface", "model.safetensors"),
        ("huggingface", "preprocessor_config.json"),
        ("transformers 5", "model.safetensors"),
        ("transformers 5", "processor_config.json"),
        ("shards", "model-00002-of"),
    ],
)
def test_a_missing_file_is_named_in_one_line(tmp_path, layout, missing):
    ALL_MAKERS[layout](tmp_path)
    next(tmp_path.glob(f"{missing}*")).unlink()
    with pytest.raises(WeightsError, match=rf"{tmp_path}.*{missing}") as refusal:
        open_encoder(str(tmp_path))
    assert "\n" not in str(refusal.value)
    if "processor" not in missing and layout != "shards":
        assert "allowed are the layouts open_clip (open_clip_config.json" in str(refusal.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [("timm_model_name", "vit_base"), ("pool_type", "avg"), ("qk_norm", True), ("layers", [1, 1, 1, 1])],
)
def test_an_unsupported_setting_of_an_open_clip_tower_is_refused_by_name(tmp_path, key, value):
    clip_models.of_open_clip(tmp_path)
    path = tmp_path / "open_clip_config.json"
    about = json.loads(path.read_text())
    about["model_cfg"]["vision_cfg"][key] = value
    path.write_text(json.dumps(about))
    with pytest.raises(WeightsError, match=rf"vision_cfg({'' if key == 'layers' else '.' + key}) is"):
        ClipFolder(tmp_path)


def test_another_model_of_hugging_face_is_refused_by_its_type(tmp_path):
    clip_models.hugging_face(tmp_path)
    path = tmp_path / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"model_type": "siglip"}))
    with pytest.raises(WeightsError, match="model_type is 'siglip'; allowed is 'clip'"):
        ClipFolder(tmp_path)


@pytest.mark.parametrize("name", ["CLIPVisionModelWithProjection", "CLIPTextModelWithProjection"])
def test_a_tower_alone_is_refused_with_what_to_save(tmp_path, name):
    clip_models.tower_alone(tmp_path, name)
    with pytest.raises(WeightsError, match="allowed is 'clip', with both towers: save the whole CLIPModel"):
        ClipFolder(tmp_path)


@pytest.mark.parametrize("text", ["{", "[]", '{"model_cfg": {}}', '{"model_cfg": [], "preprocess_cfg": {}}'])
def test_a_damaged_configuration_is_named(tmp_path, text):
    clip_models.of_open_clip(tmp_path)
    (tmp_path / "open_clip_config.json").write_text(text)
    with pytest.raises(WeightsError, match=r"open_clip_config\.json (is damaged|lacks)"):
        ClipFolder(tmp_path)


WRONG = [  # file, path of a key in it, value
    ("processor_config.json", ("image_processor", "image_mean"), [0.5, 0.5]),
    ("processor_config.json", ("image_processor", "image_std"), [0.5, 0.5, "x"]),
    ("processor_config.json", ("image_processor", "crop_size"), {"height": 64, "width": 32}),
    ("processor_config.json", ("image_processor", "crop_size"), 7),
    ("config.json", ("vision_config", "num_hidden_layers"), "2"),
    ("config.json", ("text_config", "hidden_size"), -8),
    ("config.json", ("vision_config", "layer_norm_eps"), None),
    ("config.json", ("projection_dim",), True),
]


@pytest.mark.parametrize(("name", "keys", "value"), WRONG)
def test_a_value_that_cannot_be_is_named_with_what_is_allowed(tmp_path, name, keys, value):
    clip_models.transformers_5(tmp_path)
    about = json.loads((tmp_path / name).read_text())
    place = about
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    (tmp_path / name).write_text(json.dumps(about))
    with pytest.raises(WeightsError, match=rf"{name}.*{keys[-1]} is {re.escape(repr(value))}; allowed"):
        ClipFolder(tmp_path)
