import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import safetensors.torch
import torch

from zsdist.config import CameraConfig, VisionConfig
from zsdist.datasets.labelled import labelled_views
from zsdist.errors import ImageError, WeightsError
from zsdist.vision.encoders.lite0 import FEATURES, INPUT_PX, SIDE, EfficientNetLite0
from zsdist.vision.models import COMPACT_PX, STUDENT_PX
from zsdist.vision.models.compact import Compact
from zsdist.vision.models.head import Probabilities, VisualActHead
from zsdist.vision.models.projection import Projection, attended_embeddings, image_embedding, projection_of
from zsdist.vision.models.student import Student
from zsdist.vision.rays import BINS, RAYS
from zsdist.vision.visual_act import VisualAct
from zsdist.vision.weights_folder import (
    COMPACT_FILE,
    HEAD_FILE,
    METADATA_FILE,
    PROJECTION_FILE,
    STUDENT_FILE,
    read,
    write,
)

ALONE = {"student": (STUDENT_FILE, STUDENT_PX), "compact": (COMPACT_FILE, COMPACT_PX)}

CAMERA = CameraConfig()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a folder of untrained weights."""
    encoder = EfficientNetLite0()
    with torch.random.fork_rng():
        torch.manual_seed(0)
        head, student, compact = VisualActHead(FEATURES, SIDE, np.pi / 2), Student(np.pi / 2), Compact(np.pi / 2)
        projection = Projection(FEATURES, 6)
    folder = tmp_path_factory.mktemp("weights")
    metadata = {
        "encoder": {"name": encoder.name, "sha256": encoder.sha256},
        "camera": {"field_of_view_deg": 90.0, "range_m": 5.0, "height_m": 1.0},
    }
    modules = {HEAD_FILE: head, STUDENT_FILE: student, COMPACT_FILE: compact, PROJECTION_FILE: projection}
    write(folder, {file: safetensors.torch.save(module.state_dict()) for file, module in modules.items()}, metadata)
    return folder


@pytest.fixture
def folder(made, tmp_path):
    """Return a copy of `made` that a test may damage."""
    return shutil.copytree(made, tmp_path / "weights")


def load(folder, camera=CAMERA, **settings):
    return VisualAct.load(VisionConfig(weights=str(folder), **settings), camera)


def rewrite(folder, change):
    path = folder / METADATA_FILE
    metadata = json.loads(path.read_text())
    change(metadata)
    path.write_text(json.dumps(metadata))


def images(count, px=INPUT_PX):
    return np.random.default_rng(0).integers(0, 256, (count, px, px, 3), np.uint8)


def test_the_shipped_model_gives_one_view_per_image_with_normalised_distributions():
    model = VisualAct.load(VisionConfig(), CAMERA)
    views = model(images(3), np.zeros(3), np.full(3, 6.0))
    assert len(views) == 3 and len(model.weights_sha256) == 64 and model.encoder_name == EfficientNetLite0.name
    for view in views:
        assert view.advice.shape == view.clearance_m.shape == view.dynamic.shape == (3,)
        assert view.ray_probabilities.shape == (RAYS, BINS) and view.ray_angles_rad.shape == (RAYS,)
        np.testing.assert_allclose(view.ray_probabilities.sum(1), 1, atol=1e-5)
        assert ((view.dynamic >= 0) & (view.dynamic <= 1)).all()
        assert (np.abs(view.advice) <= 2 + 1e-5).all() and (view.clearance_m <= CAMERA.range_m).all()
        assert view.advice.dtype == view.clearance_m.dtype == view.ray_probabilities.dtype == np.float32


def test_the_shipped_model_distinguishes_left_and_right_in_pictures_and_their_mirror_images():
    views = list(labelled_views(["ood-all"], "test", 40, 0, CAMERA))
    pictures = np.stack([view.image for view in views])
    true = np.array([view.clearance_m[1] - view.clearance_m[2] for view in views])
    clear = np.abs(true) > 2.0
    model, goals = VisualAct.load(VisionConfig(), CAMERA), (np.zeros(len(views)), np.full(len(views), 8.0))
    plain, mirrored = (
        np.array([view.clearance_m[1] - view.clearance_m[2] for view in model(images, *goals)])
        for images in (pictures, np.ascontiguousarray(pictures[:, :, ::-1]))
    )
    assert clear.sum() >= 8
    assert (np.sign(plain) == np.sign(true))[clear].mean() > 0.9
    assert (np.sign(mirrored) == -np.sign(true))[clear].mean() > 0.9


def test_the_goal_changes_the_advice_and_nothing_else():
    model = VisualAct.load(VisionConfig(), CAMERA)
    left, right = model(images(1).repeat(2, 0), np.array([1.2, -1.2]), np.full(2, 6.0))
    assert left.advice[1] - left.advice[2] > right.advice[1] - right.advice[2] + 0.5
    np.testing.assert_array_equal(left.ray_probabilities, right.ray_probabilities)
    np.testing.assert_array_equal(left.clearance_m, right.clearance_m)


def test_views_of_a_reading_equal_views_of_the_image_for_any_goal():
    model, goals = VisualAct.load(VisionConfig(), CAMERA), (np.array([0.8, -0.4]), np.array([3.0, 9.0]))
    reading = model.read(images(2))
    for one, other in zip(model.views(reading, *goals), model(images(2), *goals), strict=True):
        for name in ("advice", "clearance_m", "dynamic", "ray_probabilities"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    with pytest.raises(ValueError, match=r"goal bearings are \(1,\).*allowed is \(2,\)"):
        model.views(reading, np.zeros(1), np.ones(1))


def test_a_lower_quantile_gives_less_clearance(made):
    clearances = [
        VisualAct.load(VisionConfig(weights=str(made), ray_quantile=share), CAMERA)(images(1), [0.0], [5.0])[
            0
        ].clearance_m
        for share in (0.1, 0.5)
    ]
    assert (clearances[0] < clearances[1]).all()


def test_the_number_of_goals_must_be_that_of_images(made):
    with pytest.raises(ValueError, match="one for each image"):
        load(made)(images(2), np.zeros(1), np.zeros(2))


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(WeightsError, match=r"nowhere.*No such file.*'pretrained'"):
        load(tmp_path / "nowhere")


def test_a_missing_file_is_named(folder):
    (folder / HEAD_FILE).unlink()
    with pytest.raises(WeightsError, match=f"{HEAD_FILE} cannot be read"):
        load(folder)


def test_truncated_weights_are_named(folder):
    content = (folder / HEAD_FILE).read_bytes()
    (folder / HEAD_FILE).write_bytes(content[: len(content) // 2])
    with pytest.raises(WeightsError, match=f"{HEAD_FILE} are damaged: .*SHA-256"):
        load(folder)


def test_weights_for_another_encoder_are_refused(folder):
    rewrite(folder, lambda metadata: metadata["encoder"].update(name="resnet", sha256="0" * 64))
    with pytest.raises(WeightsError, match=r"'resnet'.*efficientnet-lite0"):
        load(folder)


def test_weights_for_another_camera_are_refused(folder):
    with pytest.raises(WeightsError, match=r"camera\.field_of_view_deg is 60\.0.*allow 90\.0"):
        load(folder, CAMERA.model_copy(update={"field_of_view_deg": 60.0}))


def rewritten(folder, **contents):
    """Return the folder with other contents, correctly hashed, for the files with the given stems."""
    old = read(folder)
    files = {file: old.content(file) for file in old.metadata["files"]}
    write(folder, files | {f"{stem}.safetensors": content for stem, content in contents.items()}, old.metadata)
    return folder


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    """Return a cache without networks; the encoder is opened before, since it takes long to build."""
    encoder = EfficientNetLite0()
    monkeypatch.setattr("zsdist.vision.visual_act.open_encoder", lambda spec: encoder)
    monkeypatch.setenv("ZSDIST_CACHE", str(tmp_path / "cache"))


@pytest.mark.parametrize("content", [b"", b"no tensors", safetensors.torch.save({"weight": torch.zeros(2)})])
def test_weights_of_another_network_are_refused_in_one_line(folder, empty_cache, content):
    rewritten(folder, head=content, student=content, compact=content, projection=content)
    for stem, use in (
        ("head", lambda: load(folder)),
        *((network, lambda network=network: load(folder, network=network)) for network in ALONE),
    ):
        with pytest.raises(WeightsError, match=rf"{stem}\.safetensors are not those of a {stem}: ") as refusal:
            use()
        assert "\n" not in str(refusal.value)


def test_a_damaged_projection_is_refused_when_it_is_used(folder, empty_cache):
    model = load(rewritten(folder, projection=b"no tensors"))
    with pytest.raises(WeightsError, match=r"projection\.safetensors are not those of a projection"):
        model.observe(images(1))


def test_weights_with_a_missing_or_an_additional_tensor_are_refused(folder, empty_cache):
    weights = safetensors.torch.load(read(folder).content(HEAD_FILE))
    for change in ({"one_more": torch.ones(())}, {"rays_temperature": None}):
        damaged = {name: value for name, value in (weights | change).items() if value is not None}
        with pytest.raises(WeightsError, match=next(iter(change))):
            load(rewritten(folder, head=safetensors.torch.save(damaged)))


def test_distributions_are_those_of_the_network_at_its_temperatures(folder, empty_cache):
    weights = safetensors.torch.load(read(folder).content(STUDENT_FILE))
    weights |= {"rays_temperature": torch.tensor(3.0), "clearance_temperature": torch.tensor(0.5)}
    network = Student(np.pi / 2).eval()
    network.load_state_dict(weights)
    pictures = images(2, STUDENT_PX)
    found = load(rewritten(folder, student=safetensors.torch.save(weights)), network="student").read(pictures)
    with torch.no_grad():
        logits, expected = network(torch.from_numpy(pictures)), Probabilities(network)(torch.from_numpy(pictures))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-4)
    np.testing.assert_allclose(found[2], (logits.rays / 3).softmax(-1), atol=1e-4)
    np.testing.assert_allclose(found[0], (logits.clearance / 0.5).softmax(-1), atol=1e-4)


def test_a_network_built_from_other_code_is_rebuilt(folder, empty_cache, monkeypatch):
    first = load(folder, network="student").read(images(1))
    monkeypatch.setattr("zsdist.vision.models.columns.LEVELS", 32.0)
    again = load(folder, network="student").read(images(1))
    monkeypatch.setattr("zsdist.vision.visual_act._code", lambda: "changed")
    other = load(folder, network="student").read(images(1))
    np.testing.assert_array_equal(first[2], again[2])
    assert np.abs(first[2] - other[2]).max() > 1e-4


@pytest.mark.parametrize("network", ALONE)
def test_a_network_without_an_encoder_gives_views_at_any_resolution(made, monkeypatch, network):
    monkeypatch.setattr("zsdist.vision.visual_act.open_encoder", pytest.fail)
    model, (file, own_px) = load(made, network=network), ALONE[network]
    for px in (own_px, INPUT_PX):
        views = model(images(2, px), np.zeros(2), np.full(2, 6.0))
        assert len(views) == 2 and views[0].ray_probabilities.shape == (RAYS, BINS)
        np.testing.assert_allclose(views[0].ray_probabilities.sum(1), 1, atol=1e-5)
    assert model.encoder_name == network and model.encoder_sha256 == model.weights_sha256
    assert model.weights_sha256 == read(made).sha256(file) != read(made).sha256(HEAD_FILE)


@pytest.mark.parametrize("network", ALONE)
def test_a_picture_of_the_networks_own_size_is_not_resampled(made, monkeypatch, network):
    model, pictures = load(made, network=network), images(1, ALONE[network][1])
    expected = model.read(pictures)
    monkeypatch.setattr("zsdist.vision.encoders.base._coverage", pytest.fail)
    for one, other in zip(model.read(pictures), expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_student_ignores_the_encoder_of_the_weights(folder):
    rewrite(folder, lambda metadata: metadata["encoder"].update(name="resnet", sha256="0" * 64))
    assert load(folder, network="student").encoder_name == "student"


@pytest.mark.parametrize("network", ALONE)
def test_a_network_without_an_encoder_reads_no_tokens_but_observes_as_the_head_does(made, network):
    model, pictures = load(made, network=network), images(2)
    with pytest.raises(WeightsError, match=rf"vision\.network is '{network}'.*allowed is 'head'"):
        model.read_tokens(np.zeros((1, SIDE, SIDE, FEATURES), np.float32))
    for one, other in zip(model.observe(pictures), load(made).observe(pictures), strict=True):
        np.testing.assert_array_equal(one, other)


def test_weights_of_another_encoder_are_refused_once_a_network_without_one_observes(folder):
    rewrite(folder, lambda metadata: metadata["encoder"].update(name="resnet", sha256="0" * 64))
    with pytest.raises(WeightsError, match=r"'resnet'.*efficientnet-lite0"):
        load(folder, network="compact").observe(images(1))


def test_a_folder_without_a_student_or_a_projection_is_refused_by_name(folder):
    old = read(folder)
    write(folder, {HEAD_FILE: old.content(HEAD_FILE)}, old.metadata)
    with pytest.raises(WeightsError, match=rf"hold no {STUDENT_FILE}, only {HEAD_FILE}"):
        load(folder, network="student")
    with pytest.raises(WeightsError, match=f"hold no {PROJECTION_FILE}"):
        load(folder).observe(images(1))


def test_an_observation_is_the_attention_and_the_embeddings_of_the_whole_and_the_attended_parts(made):
    model, pictures = load(made), images(2)
    look = model.observe(pictures)
    head = VisualActHead(FEATURES, SIDE, np.pi / 2).eval()
    head.load_state_dict(safetensors.torch.load(read(made).content(HEAD_FILE)))
    projection = projection_of(safetensors.torch.load(read(made).content(PROJECTION_FILE)))
    tokens = torch.from_numpy(EfficientNetLite0().tokens(pictures))
    with torch.no_grad():
        attention, projected = head(tokens).attention, projection(tokens)
        np.testing.assert_allclose(look.attention, attention, atol=1e-5)
        np.testing.assert_allclose(look.embeddings[:, 0], image_embedding(projected), atol=1e-4)
        np.testing.assert_allclose(look.embeddings[:, 1:], attended_embeddings(projected, attention), atol=1e-4)
    assert look.attention.shape == (2, 3, SIDE * SIDE) and look.embeddings.shape == (2, 4, 6)


def test_an_encoder_with_its_own_projection_needs_none_in_the_folder(folder, empty_cache, monkeypatch):
    old, rng = read(folder), np.random.default_rng(0)
    write(folder, {HEAD_FILE: old.content(HEAD_FILE)}, old.metadata)
    native = {"weight": rng.normal(size=(5, FEATURES)).astype(np.float32), "bias": np.zeros(5, np.float32)}
    monkeypatch.setattr(EfficientNetLite0, "native_projection", lambda self: native)
    model, pictures = load(folder), images(1)
    mean = EfficientNetLite0().tokens(pictures).mean((1, 2)) @ native["weight"].T
    np.testing.assert_allclose(
        model.observe(pictures).embeddings[:, 0], mean / np.linalg.norm(mean, axis=1, keepdims=True), atol=1e-4
    )


@pytest.mark.parametrize("network", ["head", *ALONE])
@pytest.mark.parametrize(
    "wrong",
    [
        np.zeros((224, 224, 3), np.uint8),
        np.zeros((1, 224, 224, 3), np.float32),
        np.zeros((1, 224, 128, 3), np.uint8),
        np.zeros((1, 224, 224, 4), np.uint8),
        np.zeros((0, 224, 224, 3), np.uint8),
        None,
    ],
    ids=["no batch", "float", "not square", "four channels", "empty", "none"],
)
def test_arrays_that_are_no_images_are_refused_in_one_line(made, network, wrong):
    model = load(made, network=network)
    for use in (model.read, lambda images: model(images, np.zeros(1), np.ones(1))):
        with pytest.raises(ImageError, match=r"images are .*; allowed are") as refusal:
            use(wrong)
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("network", ["head", "compact"])
def test_a_built_model_reads_and_observes_without_torch(made, network):
    load(made, network=network), load(made).observe(images(1))

    code = (
        "import sys, numpy as np; from zsdist.config import CameraConfig, VisionConfig;"
        "from zsdist.vision.visual_act import VisualAct;"
        f"m = VisualAct.load(VisionConfig(weights={str(made)!r}, network={network!r}), CameraConfig());"
        f"i = np.zeros((1, 224, 224, 3), np.uint8); m(i, np.zeros(1), np.ones(1)); m.observe(i);"
        "print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
