import numpy as np
import pytest
import torch

from zsdist.vision.rays import BIN_EDGES_M, BINS, RANGE_M, quantile_m
from zsdist.vision.scores import calibration
from zsdist.vision.training.calibration import fit


def world(count, temperature, seed=0):
    """Return logits, and true distances drawn from the distributions of the logits divided by `temperature`."""
    rng = np.random.default_rng(seed)
    logits = 2 * torch.from_numpy(rng.standard_normal((count, 4, BINS)).astype(np.float32))
    cumulated = (logits / temperature).softmax(-1).cumsum(-1).numpy()
    bins = (cumulated < rng.random((count, 4, 1))).sum(-1).clip(max=BINS - 1)
    upper_m = np.append(BIN_EDGES_M[1:], RANGE_M)
    return logits, BIN_EDGES_M[bins] + rng.random(bins.shape, np.float32) * (upper_m - BIN_EDGES_M)[bins]


@pytest.mark.parametrize("temperature", [0.4, 1.0, 2.5])
def test_the_temperature_that_made_the_truth_is_found(temperature):
    assert fit(*world(3000, temperature)) == pytest.approx(temperature, rel=0.15)


def test_a_fitted_temperature_brings_the_share_below_the_quantile_to_its_nominal_value():
    logits, true_m = world(3000, 0.4)
    unseen, unseen_m = world(3000, 0.4, seed=1)

    def share(temperature):
        probabilities = (unseen / temperature).softmax(-1).numpy()
        return calibration(quantile_m(probabilities, 0.1), unseen_m, RANGE_M)["short"]

    assert abs(share(fit(logits, true_m)) - 0.1) < 0.02 < abs(share(1.0) - 0.1)


def test_pictures_with_certainly_free_rays_alone_are_refused():
    free = torch.zeros(4, BINS)
    free[:, -1] = 1e3
    with pytest.raises(ValueError, match="every quantile is free"):
        fit(free, np.full(4, RANGE_M))


def test_logits_and_distances_of_different_shapes_are_refused():
    logits, true_m = world(5, 1.0)
    for distances in (true_m[:3], true_m[..., None]):
        with pytest.raises(ValueError, match="logits are"):
            fit(logits, distances)
    with pytest.raises(ValueError, match="not empty"):
        fit(logits[:0], true_m[:0])
