import numpy as np
import torch

from zsdist.vision.models.head import Probabilities, VisualActHead, attention
from zsdist.vision.rays import BINS, RAYS

FEATURES, SIDE = 8, 14


def head():
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return VisualActHead(FEATURES, SIDE, np.pi / 2, width=16, column_width=12).eval()


def tokens(seed=0, batch=2):
    return torch.from_numpy(np.random.default_rng(seed).normal(size=(batch, SIDE, SIDE, FEATURES)).astype(np.float32))


def test_eq04_is_the_softmax_of_scaled_products_times_the_values():
    rng = np.random.default_rng(1)
    q, k, v = (rng.normal(size=shape) for shape in ((3, 4), (5, 4), (5, 2)))
    scores = np.exp(q @ k.T / np.sqrt(4))
    expected = scores / scores.sum(1, keepdims=True) @ v
    everything = torch.ones(3, 5, dtype=torch.bool)
    mixed, weights = attention(*map(torch.from_numpy, (q, k, v)), everything)
    np.testing.assert_allclose(mixed, expected, rtol=1e-9)
    np.testing.assert_allclose(weights.sum(1), 1.0)


def test_eq04_gives_no_weight_to_a_masked_token():
    rng = np.random.default_rng(2)
    q, k, v = (torch.from_numpy(rng.normal(size=shape)) for shape in ((3, 4), (5, 4), (5, 2)))
    allowed = torch.tensor([[True, True, True, False, True]]).expand(3, -1)
    before, weights = attention(q, k, v, allowed)
    k[3], v[3] = 1e3, 1e3
    np.testing.assert_array_equal(attention(q, k, v, allowed)[0], before)
    assert (weights[:, 3] == 0).all()


def test_shapes_are_three_actions_and_all_rays():
    reading = head()(tokens())
    assert reading.clearance.shape == (2, 3, BINS) and reading.dynamic.shape == (2, 3)
    assert reading.rays.shape == (2, RAYS, BINS) and reading.attention.shape == (2, 3, SIDE * SIDE)


def test_the_queries_of_left_and_right_do_not_attend_to_the_other_side():
    allowed = head().attention.allowed.reshape(3, SIDE, SIDE)
    assert not allowed[1, :, -4:].any() and not allowed[2, :, :4].any()
    assert allowed[0, :, SIDE // 2].all() and allowed.any(0).all()


def test_a_change_on_the_left_changes_the_left_rays_most():
    changed = tokens()
    changed[:, :, 1] += 3.0
    with torch.no_grad():
        difference = (head()(changed)[2] - head()(tokens())[2]).abs().sum((0, 2))
    assert difference[:6].sum() > 3 * difference[-6:].sum()


def test_images_of_a_batch_do_not_mix():
    with torch.no_grad():
        both, alone = head()(tokens())[2], head()(tokens()[1:])[2]
    np.testing.assert_allclose(both[1:], alone, atol=1e-5)


def test_tokens_are_normalised():
    plain, scaled = head(), head()
    scaled.normalise_to(np.full(FEATURES, 5.0, np.float32), np.full(FEATURES, 3.0, np.float32))
    with torch.no_grad():
        np.testing.assert_allclose(scaled(tokens() * 3 + 5)[0], plain(tokens())[0], atol=1e-4)


def test_a_temperature_sharpens_or_widens_distributions_and_leaves_the_logits():
    network = head()
    with torch.no_grad():
        plain, before = Probabilities(network)(tokens()), network(tokens())
        network.clearance_temperature.fill_(4.0)
        network.rays_temperature.fill_(0.25)
        fitted, after = Probabilities(network)(tokens()), network(tokens())
    assert fitted[0].max(-1).values.mean() < plain[0].max(-1).values.mean()
    assert fitted[2].max(-1).values.mean() > plain[2].max(-1).values.mean()
    for part in (*plain[::2], *fitted[::2]):
        np.testing.assert_allclose(part.sum(-1), 1.0, rtol=1e-5)
    assert torch.equal(plain[1], fitted[1]) and torch.equal(before.rays, after.rays)
