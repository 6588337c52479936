import math

import numpy as np

from zsdist.vision.labels import nearest
from zsdist.vision.rays import RANGE_M, RAYS, ray_angles_rad, soft_labels
from zsdist.vision.training.examples import Examples, targets

ANGLES = ray_angles_rad(RAYS, math.pi / 2)


def examples(count, seed):
    rng = np.random.default_rng(seed)
    distance = np.minimum(rng.uniform(0.3, 1.5 * RANGE_M, (count, RAYS)), RANGE_M).astype(np.float32)
    tokens = rng.standard_normal((count, 4, 4, 3)).astype(np.float16)
    return Examples(tokens, distance, rng.random((count, RAYS)) < 0.3, ANGLES)


def test_a_mirrored_view_has_mirrored_rays_and_its_left_and_right_exchanged():
    data, index = examples(4, 5), np.arange(4)
    plain = targets(data, index, np.zeros(4, bool), np.random.default_rng(0))
    mirrored = targets(data, index, np.ones(4, bool), np.random.default_rng(0))
    np.testing.assert_array_equal(mirrored.tokens, plain.tokens.flip(2))
    np.testing.assert_array_equal(mirrored.rays, plain.rays.flip(1))
    np.testing.assert_allclose(mirrored.clearance, plain.clearance[:, [0, 2, 1]], atol=1e-6)


def test_making_targets_leaves_the_examples_unchanged():
    data, again = examples(4, 5), examples(4, 5)
    targets(data, np.arange(4), np.ones(4, bool), np.random.default_rng(0))
    np.testing.assert_array_equal(data.tokens, again.tokens)
    np.testing.assert_array_equal(data.ray_distance_m, again.ray_distance_m)


def test_labels_of_a_batch_are_those_of_its_rays():
    data = examples(4, 5)
    batch = targets(data, np.arange(4), np.zeros(4, bool), np.random.default_rng(0))
    clearance, dynamic = nearest(data.ray_distance_m, data.ray_dynamic, ANGLES)
    np.testing.assert_allclose(batch.clearance, soft_labels(clearance))
    np.testing.assert_array_equal(batch.dynamic, dynamic)
    np.testing.assert_array_equal(batch.present, clearance < RANGE_M)
