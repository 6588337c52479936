import json

import numpy as np
import pytest
import torch

from zsdist.config import CameraConfig, VisionConfig
from zsdist.errors import WeightsError
from zsdist.sim.views import labelled_views
from zsdist.vision.encoders.lite0 import FEATURES, INPUT_PX, SIDE, EfficientNetLite0
from zsdist.vision.folder import HEAD_FILE, METADATA_FILE
from zsdist.vision.models.head import VisualActHead
from zsdist.vision.rays import BINS, RAYS
from zsdist.vision.training.head import save
from zsdist.vision.visual_act import VisualAct

CAMERA = CameraConfig()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a small amount of training: none."""
    encoder = EfficientNetLite0()
    with torch.random.fork_rng():
        torch.manual_seed(0)
        head = VisualActHead(FEATURES, SIDE, np.pi / 2)
    folder = tmp_path_factory.mktemp("weights")
    metadata = {
        "encoder": {"name": encoder.name, "sha256": encoder.sha256},
        "camera": {"field_of_view_deg": 90.0, "range_m": 5.0, "height_m": 1.0},
    }
    save(head, folder, metadata)
    return folder


@pytest.fixture
def folder(made, tmp_path):
    """A copy of `made` to spoil."""
    for name in (HEAD_FILE, METADATA_FILE):
        (tmp_path / name).write_bytes((made / name).read_bytes())
    return tmp_path


def load(folder, camera=CAMERA):
    return VisualAct.load(VisionConfig(weights=str(folder)), camera)


def rewrite(folder, change):
    path = folder / METADATA_FILE
    metadata = json.loads(path.read_text())
    change(metadata)
    path.write_text(json.dumps(metadata))


def images(count):
    return np.random.default_rng(0).integers(0, 256, (count, INPUT_PX, INPUT_PX, 3), np.uint8)


def test_the_shipped_model_gives_one_view_an_image_with_proper_distributions():
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


def test_the_shipped_model_tells_left_from_right_in_pictures_and_in_their_mirror_images():
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


def test_a_lower_quantile_sees_less_room(made):
    clearances = [
        VisualAct.load(VisionConfig(weights=str(made), ray_quantile=share), CAMERA)(images(1), [0.0], [5.0])[
            0
        ].clearance_m
        for share in (0.1, 0.5)
    ]
    assert (clearances[0] < clearances[1]).all()


def test_goals_must_be_one_an_image(made):
    with pytest.raises(ValueError, match="one an image"):
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
    rewrite(folder, lambda metadata: metadata["encoder"].update(name="resnet"))
    with pytest.raises(WeightsError, match=r"'resnet'.*efficientnet-lite0"):
        load(folder)


def test_weights_for_another_camera_are_refused(folder):
    with pytest.raises(WeightsError, match=r"camera\.field_of_view_deg is 60\.0.*allow 90\.0"):
        load(folder, CAMERA.model_copy(update={"field_of_view_deg": 60.0}))


def test_weights_of_another_network_are_refused(folder, tmp_path, monkeypatch):
    trunk = EfficientNetLite0()
    monkeypatch.setenv("ZSDIST_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("zsdist.vision.visual_act.open_encoder", lambda spec: trunk)
    metadata = json.loads((folder / METADATA_FILE).read_text())
    save(torch.nn.Linear(2, 2), folder, metadata)
    with pytest.raises(WeightsError, match="not those of a head"):
        load(folder)
