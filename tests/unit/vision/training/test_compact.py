import itertools
import math

import numpy as np
import torch

from zsdist.vision.models import COMPACT_PX, COMPACT_ROWS
from zsdist.vision.models.compact import Compact
from zsdist.vision.rays import RANGE_M, RAYS, exact_labels, ray_angles_rad
from zsdist.vision.training import compact as training
from zsdist.vision.training.examples import Examples
from zsdist.vision.training.head import validate
from zsdist.vision.training.trainer import Recipe

ANGLES = ray_angles_rad(RAYS, math.pi / 2)
PICTURES = 16


def examples(count, seed):
    """Return pictures in which a column is brighter the nearer its obstacle is."""
    rng = np.random.default_rng(seed)
    distance = np.where(rng.random((count, 4)) < 0.4, RANGE_M, rng.uniform(0.3, RANGE_M, (count, 4)))
    distance = distance.repeat(RAYS // 4, 1).astype(np.float32)
    bright = (40 + 40 * (RANGE_M - distance)).repeat(COMPACT_PX // RAYS, 1)
    images = np.broadcast_to(bright[:, None, :, None], (count, COMPACT_ROWS, COMPACT_PX, 3)).astype(np.uint8)
    return Examples(images, distance, rng.random((count, RAYS)) < 0.2, ANGLES)


def fresh(first):
    return (examples(PICTURES, 100 + number) for number in itertools.count(first))


def small():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return Compact(math.pi / 2, (4, 6, 8), 16)


def trainer(network, epochs=4, source=fresh):
    recipe, rng = Recipe(epochs=epochs, batch=8, average=0.9), np.random.default_rng(0)
    return training.train(network, PICTURES, source, examples(8, 1), recipe, rng, lambda: 0.0)


def test_training_lowers_the_loss_on_pictures_it_has_not_seen():
    network, unseen = small(), examples(16, 2)
    before = validate(network, unseen, 16, exact_labels)
    figures = list(trainer(network, epochs=6))
    after = validate(network, unseen, 16, exact_labels)
    assert after["rays"] < 0.9 * before["rays"] and sum(after.values()) < sum(before.values())
    assert {"epoch", "learning_rate", "loss", "validation_loss", "validation_rays"} <= set(figures[-1])


def test_each_epoch_gets_new_pictures_from_the_one_on_where_the_training_is():
    asked = []

    def source(first):
        for number in itertools.count(first):
            asked.append(number)
            yield examples(PICTURES, 100 + number)

    begun = trainer(small(), source=source)
    next(begun), next(begun)
    resumed = trainer(small(), source=source)
    resumed.restore(begun.state())
    assert [line["epoch"] for line in resumed] == [3, 4] and asked == [0, 1, 2, 3]


def test_a_resumed_training_ends_with_the_weights_of_one_that_was_not_interrupted():
    whole, again = small(), small()
    list(trainer(whole))
    begun = trainer(small())
    next(begun), next(begun)
    resumed = trainer(again)
    resumed.restore(begun.state())
    list(resumed)
    for name, value in whole.state_dict().items():
        assert torch.equal(value, again.state_dict()[name])


def test_a_new_network_follows_from_its_seed():
    one, same, other = (training.new_compact(math.pi / 2, seed).queries for seed in (1, 1, 2))
    assert torch.equal(one, same) and not torch.equal(one, other)
