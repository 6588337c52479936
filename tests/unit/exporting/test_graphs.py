import clip_models
import numpy as np
import onnx
import pytest
import safetensors.torch
import torch

from zsdist.config import CameraConfig, VisionConfig
from zsdist.dqn import network
from zsdist.errors import WeightsError
from zsdist.exporting.graphs import write_network, write_vision
from zsdist.roles.shapes import SHAPES
from zsdist.types import Level
from zsdist.vision import weights_folder
from zsdist.vision.encoders import open_encoder
from zsdist.vision.exported import open_session
from zsdist.vision.models.head import VisualActHead
from zsdist.vision.reading import READING_OUTPUTS
from zsdist.vision.visual_act import VisualAct
from zsdist.vision.weights_folder import HEAD_FILE


def clip(tmp_path, layout):
    """Return vision on a tiny CLIP encoder, with an untrained head."""
    folder, weights = tmp_path / "tiny-clip", tmp_path / "weights"
    folder.mkdir()
    layout(folder)
    encoder = open_encoder(str(folder))
    with torch.random.fork_rng():
        torch.manual_seed(0)
        head = VisualActHead(encoder.features, encoder.side, np.pi / 2)
    metadata = {
        "encoder": {"name": encoder.name, "sha256": encoder.sha256},
        "camera": {"field_of_view_deg": 90.0, "range_m": 5.0, "height_m": 1.0},
    }
    weights_folder.write(weights, {HEAD_FILE: safetensors.torch.save(head.state_dict())}, metadata)
    return VisualAct.load(VisionConfig(encoder=str(folder), weights=str(weights)), CameraConfig())


def shipped(network):
    return VisualAct.load(VisionConfig(network=network), CameraConfig())


def check_vision(visual_act, path):
    graph = write_vision(visual_act, path)
    px = graph.inputs[0].shape[1]
    images = np.random.default_rng(1).integers(0, 256, (1, px, px, 3), np.uint8)
    found = open_session(path).run(READING_OUTPUTS, {"image": images})
    for ours, theirs, port in zip(found, visual_act.read(images), graph.outputs, strict=True):
        np.testing.assert_array_equal(ours, theirs)  # bit for bit: the map must not depend on who reads
        assert port.shape[1:] == ours.shape[1:] and port.dtype == ours.dtype.name
    model = onnx.load(str(path))
    onnx.checker.check_model(model)
    assert [port.name for port in model.graph.output] == READING_OUTPUTS


@pytest.mark.parametrize("network", ["head", "student"])
def test_vision_in_one_file_reads_as_its_parts_do(tmp_path, network):
    check_vision(shipped(network), tmp_path / "vision.onnx")


def test_vision_on_a_clip_encoder_is_one_file_too(tmp_path):
    check_vision(clip(tmp_path, clip_models.hugging_face), tmp_path / "vision.onnx")


@pytest.mark.parametrize("level", Level)
@pytest.mark.parametrize("hidden", [(128, 128), (16,)])
def test_a_q_network_has_the_values_of_the_one_that_acts(tmp_path, level, hidden):
    shape = SHAPES[level]
    parameters = network.initial_parameters(shape.state_size, shape.actions, hidden, seed=3)
    graph = write_network(level, parameters, tmp_path / "q.onnx")
    states = np.random.default_rng(2).normal(size=(7, shape.state_size)).astype(np.float32)
    (found,) = open_session(tmp_path / "q.onnx").run(["values"], {"state": states})
    np.testing.assert_allclose(found, network.apply(parameters, states), atol=1e-6)
    assert graph.inputs[0].shape == ("batch", shape.state_size) and graph.outputs[0].shape == ("batch", shape.actions)


def test_weights_of_another_size_are_refused(tmp_path):
    parameters = network.initial_parameters(10, 5, (8,), seed=0)
    with pytest.raises(WeightsError, match=r"hidden0\.weight is .*; allowed is"):
        write_network(Level.LOW, parameters, tmp_path / "q.onnx")
