import itertools
import math

import numpy as np
import pytest
import torch

from zsdist.vision.rays import RANGE_M, RAYS, ray_angles_rad
from zsdist.vision.training.examples import Examples
from zsdist.vision.training.head import new_head, train, validate
from zsdist.vision.training.trainer import Recipe

SIDE, FEATURES = 8, 6
ANGLES = ray_angles_rad(RAYS, math.pi / 2)
QUICK = Recipe(epochs=6, batch=16)


def examples(count, seed):
    """Return examples whose columns have as features the distance, and whether the obstacle moves."""
    rng = np.random.default_rng(seed)
    distance = np.where(rng.random((count, SIDE)) < 0.4, RANGE_M, rng.uniform(0.3, RANGE_M, (count, SIDE)))
    moving = (rng.random((count, SIDE)) < 0.3) & (distance < RANGE_M)
    tokens = 0.1 * rng.standard_normal((count, SIDE, SIDE, FEATURES))
    tokens[..., 0] += distance[:, None]
    tokens[..., 1] += 3 * moving[:, None]
    each = RAYS // SIDE
    return Examples(
        tokens.astype(np.float16), distance.repeat(each, 1).astype(np.float32), moving.repeat(each, 1), ANGLES
    )


def fit(seed=0, recipe=QUICK, time_used=lambda: 0.0):
    data = examples(128, 0)
    head = new_head(data, math.pi / 2, seed)
    history = list(train(head, data, examples(48, 1), recipe, np.random.default_rng(seed), time_used))
    return head, history


def test_training_lowers_each_part_of_the_loss_on_views_it_has_not_seen():
    unseen = examples(48, 2)
    before = validate(new_head(examples(128, 0), math.pi / 2, 0), unseen, 48)
    after = validate(fit()[0], unseen, 48)
    assert {name for name in before if after[name] >= before[name]} == set()
    assert after["rays"] < 0.6 * before["rays"] and after["actions"] < 0.8 * before["actions"]


def test_training_repeats_exactly_with_its_seed():
    (first, history), (second, again) = fit(recipe=Recipe(epochs=2)), fit(recipe=Recipe(epochs=2))
    assert history == again
    for name, value in first.state_dict().items():
        np.testing.assert_array_equal(value, second.state_dict()[name])


def test_training_ends_with_the_weights_of_its_best_epoch():
    head, history = fit(recipe=Recipe(epochs=3))
    best = min(figures["validation_loss"] for figures in history)
    assert sum(validate(head, examples(48, 1), 64).values()) == pytest.approx(best, rel=1e-5)


def test_training_stops_when_its_time_is_used():
    _, history = fit(recipe=Recipe(epochs=50), time_used=itertools.count(0, 0.15).__next__)
    assert len(history) < 4 and history[-1]["learning_rate"] < 1e-3


def test_training_stops_when_the_validation_loss_does_not_improve():
    _, history = fit(recipe=Recipe(epochs=20, learning_rate=1e-9, patience=1))
    assert len(history) < 20


class AttendTo:
    """Contrast that pulls the attention of each action to one token."""

    def __init__(self, token):
        self.token, self.drawn = token, []

    def loss(self, head, rng):
        self.drawn.append(rng.random())
        attention = head(torch.from_numpy(examples(4, 3).tokens.astype(np.float32))).attention
        return -100 * (attention[..., self.token] + 1e-3).log().mean()


def test_the_contrast_draws_the_attention_while_the_head_learns():
    token = 3 * SIDE + SIDE // 2
    attended = {}
    for contrast in (None, AttendTo(token)):
        head, data = new_head(examples(64, 0), math.pi / 2, 0), examples(64, 0)
        recipe = Recipe(epochs=3, batch=8, learning_rate=0.01)
        training = train(head, data, data, recipe, np.random.default_rng(0), lambda: 0.0, contrast)
        history = list(training)
        attention = head(torch.from_numpy(data.tokens).float()).attention.detach()
        attended[contrast is None] = float(attention[:, 0, token].mean())
    assert attended[False] > 2 * attended[True]
    assert "loss_contrast" in history[0] and "validation_contrast" not in history[0]
    assert len(set(contrast.drawn)) == len(contrast.drawn) == 24
