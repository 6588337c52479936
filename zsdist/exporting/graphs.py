"""Networks of a bundle as ONNX files: vision in one piece, and the Q-network of each level."""

from pathlib import Path

import numpy as np
import onnx
from onnx import compose

from zsdist import __version__
from zsdist.agent import blocks, features
from zsdist.dqn import network
from zsdist.dqn.torch_network import QNetwork
from zsdist.errors import WeightsError
from zsdist.runtime.graphs import PICTURE, STATE, VALUES
from zsdist.runtime.manifest import BundleGraph, GraphPort
from zsdist.types import Action, Level, Parameters
from zsdist.vision.exported import TOLERANCE, export, open_session
from zsdist.vision.labels import DIRECTIONS
from zsdist.vision.rays import BINS, RAYS
from zsdist.vision.reading import READING_OUTPUTS
from zsdist.vision.visual_act import VisualAct

_BATCH = "batch"
_BINS = "probabilities of the distance by bin, in metres from 0.25 to 5 in equal steps of its logarithm; the last: free"
_CHOICES = {
    Level.HIGH: "value of the block k eighths of a turn to the left of the heading, k = 0 to 7; the last: the goal",
    Level.LOW: f"value of each action: {', '.join(action.name for action in Action)}",
}


def write_vision(visual_act: VisualAct, path: Path) -> BundleGraph:
    """Write the network from pictures to readings as one file, and return its description.

    Raises:
        WeightsError: the parts cannot be joined, or the file gives other readings than they do.
    """
    models = [onnx.load(str(file)) for file in visual_act.network_files]
    try:
        model = models[0] if len(models) == 1 else _join(*models)
    except ValueError as error:  # parts that were exported by different versions of torch
        raise WeightsError(
            f"encoder and head in {visual_act.network_files[0].parent} cannot be joined ({error}); delete that folder, "
            "and they are made anew"
        ) from error
    _sign(model)
    onnx.save(model, str(path))
    px = int(model.graph.input[0].type.tensor_type.shape.dim[1].dim_value)
    images = np.random.default_rng(0).integers(0, 256, (1, px, px, 3), np.uint8)
    found = open_session(path).run(READING_OUTPUTS, {PICTURE: images})
    for name, ours, theirs in zip(READING_OUTPUTS, found, visual_act.read(images), strict=True):
        if not np.abs(ours - theirs).max() <= TOLERANCE:
            raise WeightsError(f"exported vision differs in {name} from the network that it was made of")
    directions = ", ".join(DIRECTIONS)
    return BundleGraph(
        file=path.name,
        normalisation=f"inside; a picture of another size is first resampled to {px} pixels a side by area",
        inputs=(_port(PICTURE, (px, px, 3), "uint8", "0 to 255", "rows from the top, columns from the left; R, G, B"),),
        outputs=(
            _port("clearance", (3, BINS), meaning=f"nearest obstacle {directions}: {_BINS}"),
            _port(
                "dynamic", (3,), meaning=f"probability that the nearest obstacle {directions} is of a kind that moves"
            ),
            _port(
                "rays", (RAYS, BINS), meaning=f"obstacle along each ray, leftmost first, equal pixel columns: {_BINS}"
            ),
        ),
    )


def write_network(level: Level, parameters: Parameters, path: Path) -> BundleGraph:
    """Write the Q-network of a level, and return its description.

    Raises:
        WeightsError: the file gives other values than the network.
    """
    size = features.HIGH_STATE_SIZE if level is Level.HIGH else features.LOW_STATE_SIZE
    choices = blocks.HIGH_ACTIONS if level is Level.HIGH else features.LOW_ACTIONS
    network.check(parameters, size, choices)
    states = np.random.default_rng(0).normal(size=(4, size)).astype(np.float32)
    export(QNetwork(parameters), states, path, STATE, [VALUES])
    model = onnx.load(str(path))
    _sign(model)
    onnx.save(model, str(path))
    described = f"features of the situation, as zsdist.agent.features makes them for the {level} level"
    return BundleGraph(
        file=path.name,
        normalisation="none inside; the features are scaled where they are made",
        inputs=(_port(STATE, (size,), meaning=described),),
        outputs=(_port(VALUES, (choices,), unit="discounted reward", meaning=_CHOICES[level]),),
    )


def _join(encoder: onnx.ModelProto, head: onnx.ModelProto) -> onnx.ModelProto:
    """Return encoder and head as one network from pictures to readings."""
    encoder = compose.add_prefix(encoder, "encoder/", rename_inputs=False)
    head = compose.add_prefix(head, "head/", rename_outputs=False)
    joined: onnx.ModelProto = compose.merge_models(
        encoder, head, io_map=[("encoder/tokens", "head/tokens")], outputs=READING_OUTPUTS
    )
    return joined


def _sign(model: onnx.ModelProto) -> None:
    model.producer_name, model.producer_version = "zsdist", __version__


def _port(name: str, shape: tuple[int, ...], dtype: str = "float32", unit: str = "", meaning: str = "") -> GraphPort:
    return GraphPort(name=name, shape=(_BATCH, *shape), dtype=dtype, unit=unit, meaning=meaning)
