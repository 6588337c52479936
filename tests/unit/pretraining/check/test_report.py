import numpy as np

from zsdist.pretraining.check.predictions import Predictions
from zsdist.pretraining.check.report import SHARES, reliability, worst_misses
from zsdist.pretraining.check.sets import Sample
from zsdist.vision.rays import BINS, RAYS


def predictions(predicted_m, true_m):
    """Return synthetic predictions for N pictures with distances `(N, R)` and flat distributions."""
    count = len(predicted_m)
    three, flat = np.zeros((count, 3)), np.full((count, RAYS, BINS), 1 / BINS)
    numbers, names = np.zeros(count), np.array(["made-up"] * count)
    objects = np.zeros((count, RAYS), int)
    return Predictions(three, three, flat, predicted_m, three, three, true_m, objects, names, numbers, numbers)


def test_the_worst_misses_are_those_of_which_most_was_missed():
    true, predicted = np.full((3, RAYS), 1.0), np.full((3, RAYS), 1.0)
    predicted[0, 4] = 5.0
    predicted[1, 2:8], predicted[1, 5] = 3.0, 4.0
    samples = [Sample(np.zeros((8, 8, 3), np.uint8), *[None] * 6) for _ in range(3)]
    found = worst_misses(predictions(predicted, true), samples, "made up", 3)
    assert [miss.predicted_m.tolist() for miss in found] == [predicted[1].tolist(), predicted[0].tolist()]
    assert found[0].worst == 5 and found[1].worst == 4


def test_reliability_lies_on_the_diagonal_if_the_truth_follows_the_prediction():
    from zsdist.vision.rays import quantile_m

    rng = np.random.default_rng(0)
    drawn = rng.uniform(0.001, 0.999, (400, RAYS))
    flat = np.full((1, BINS), 1 / BINS)
    true = np.array([quantile_m(flat, share)[0] for share in drawn.ravel()]).reshape(drawn.shape)
    shares, under = reliability(predictions(true, true))
    assert np.abs(under - shares)[SHARES < 0.96].max() < 0.02
