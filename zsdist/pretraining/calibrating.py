"""The last touch to a trained network: temperatures that make its distributions as wide as its errors are."""

import numpy as np
import torch
from torch import Tensor, nn

from zsdist.vision.labels import nearest
from zsdist.vision.training.calibration import fit
from zsdist.vision.training.examples import Examples

_AT_ONCE = 64


def calibrate(network: nn.Module, examples: Examples) -> None:
    """Sets the temperatures of a head, or a student, by pictures that it was not trained on.

    Args:
        network: has buffers `clearance_temperature` and `rays_temperature`, and gives a `Reading` with raw logits.
        examples: with what the network takes in the place of `tokens`.
    """
    clearance_m, _ = nearest(examples.ray_distance_m, examples.ray_dynamic, examples.ray_angles_rad)
    clearance, rays = _logits(network, examples)
    network.clearance_temperature.fill_(fit(clearance, clearance_m))
    network.rays_temperature.fill_(fit(rays, examples.ray_distance_m))


def _logits(network: nn.Module, examples: Examples) -> tuple[Tensor, Tensor]:
    network.eval()
    parts = []
    with torch.no_grad():
        for start in range(0, len(examples), _AT_ONCE):
            batch = examples.tokens[start : start + _AT_ONCE].astype(np.float32)
            reading = network(torch.from_numpy(batch))
            parts.append((reading.clearance, reading.rays))
    clearance, rays = zip(*parts, strict=True)
    return torch.cat(clearance), torch.cat(rays)
