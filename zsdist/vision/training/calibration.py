"""Calibration of a trained network: a temperature fits the width of its distance distributions to its errors."""

import numpy as np
import torch
from torch import Tensor, nn

from zsdist.vision.labels import nearest
from zsdist.vision.rays import RANGE_M, quantile_m
from zsdist.vision.scores import calibration
from zsdist.vision.training.examples import Examples

SHARE = 0.1  # share of the calibrated quantile: the truth should lie below it this often
TEMPERATURES = np.geomspace(0.125, 8.0, 61)  # candidates, 7% apart
_BATCH = 64


def fit(logits: Tensor, true_m: np.ndarray) -> float:
    """Return the divisor of the logits with which the truth lies below the low quantile as often as it should.

    It is the one of `TEMPERATURES` whose share of truths below the quantile `SHARE` is nearest to `SHARE`. Only rays
    whose quantile is below the range count: nothing can lie below a quantile that is free. The temperature of maximum
    likelihood differs. It fits the whole distribution, in which the middle, and labels wider than their bin, weigh more
    than the near end, while the map is built from the near end.

    Args:
        logits: `(..., BINS)`, before any temperature, of pictures that were not trained on.
        true_m: `(...)` true distances in metres.

    Raises:
        ValueError: the shapes do not fit, or there is nothing to fit to.
    """
    if tuple(logits.shape[:-1]) != np.shape(true_m) or not np.size(true_m):
        raise ValueError(
            f"logits are {tuple(logits.shape)} and distances {np.shape(true_m)}; "
            "allowed are (..., BINS) and (...), not empty"
        )
    logits, capped_m = logits.detach(), np.minimum(true_m, RANGE_M)

    def error(temperature: float) -> float:
        probabilities = torch.softmax(logits / temperature, -1).numpy()
        below = calibration(quantile_m(probabilities, SHARE), capped_m, RANGE_M)["short"]
        return abs(below - SHARE) if np.isfinite(below) else np.inf

    errors = [error(temperature) for temperature in TEMPERATURES]
    if not np.isfinite(errors).any():
        raise ValueError("distances cannot be calibrated: every quantile is free; allowed are pictures with obstacles")
    return float(TEMPERATURES[int(np.argmin(errors))])


def calibrate(network: nn.Module, examples: Examples) -> None:
    """Set the temperatures of a head or a student from pictures on which it was not trained.

    Args:
        network: head or student with the buffers `clearance_temperature` and `rays_temperature`; it returns a
            `HeadOutput` of raw logits.
        examples: examples whose `tokens` are the input of the network.
    """
    clearance_m, _ = nearest(examples.ray_distance_m, examples.ray_dynamic, examples.ray_angles_rad)
    clearance, rays = _logits(network, examples)
    network.get_buffer("clearance_temperature").fill_(fit(clearance, clearance_m))
    network.get_buffer("rays_temperature").fill_(fit(rays, examples.ray_distance_m))


def _logits(network: nn.Module, examples: Examples) -> tuple[Tensor, Tensor]:
    """Return the logits of clearance `(N, 3, BINS)` and of rays `(N, R, BINS)` for all examples."""
    network.eval()
    parts = []
    with torch.no_grad():
        for start in range(0, len(examples), _BATCH):
            batch = examples.tokens[start : start + _BATCH].astype(np.float32)
            output = network(torch.from_numpy(batch))
            parts.append((output.clearance, output.rays))
    clearance, rays = zip(*parts, strict=True)
    return torch.cat(clearance), torch.cat(rays)
