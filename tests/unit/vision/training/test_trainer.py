import itertools
import math

import numpy as np
import pytest
import torch
from torch import nn

from zsdist.errors import RunError, WeightsError
from zsdist.vision.training.trainer import Recipe, Trainer, one_cycle

BATCHES = 4


def trainer(recipe, validation=None, seed=0, time_used=lambda: 0.0, width=5):
    """Return a network with dropout that learns to add, and its trainer; `validation` gives the validation losses."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = nn.Sequential(nn.Linear(3, width), nn.Dropout(0.1), nn.ReLU(), nn.Linear(width, 1))

    def error(x):
        return (network(x)[:, 0] - x.sum(1)).square().mean()

    def losses(rng):
        for _ in range(BATCHES):
            loss = error(torch.from_numpy(rng.standard_normal((16, 3)).astype(np.float32)))
            yield loss, {"error": float(loss.detach())}

    def validate():
        network.eval()
        with torch.no_grad():
            return {"error": float(error(torch.eye(3))) if validation is None else next(validation)}

    return network, Trainer(network, recipe, BATCHES, losses, validate, np.random.default_rng(seed), time_used)


def weights(network):
    return {name: value.clone() for name, value in network.state_dict().items()}


def same(one, other):
    return all(torch.equal(one[name], other[name]) for name in one)


def test_each_epoch_reports_its_losses_and_their_parts():
    _, training = trainer(Recipe(epochs=20, learning_rate=0.03, patience=20))
    figures = list(training)
    assert [f["epoch"] for f in figures] == list(range(1, 21))
    assert figures[-1]["loss"] < 0.5 * figures[0]["loss"]
    for f in figures:
        assert f["loss"] == pytest.approx(f["loss_error"]) and f["validation_loss"] == f["validation_error"]


def test_training_ends_with_the_weights_of_the_best_epoch():
    network, training = trainer(Recipe(epochs=4), iter([3.0, 1.0, 2.0, 4.0]))
    seen = [weights(network) for _ in training]
    assert same(weights(network), seen[1]) and not same(seen[1], seen[3])


def test_training_stops_when_the_validation_loss_does_not_improve():
    assert len(list(trainer(Recipe(epochs=20, patience=3), iter([2.0, 1.0] + [1.0] * 18))[1])) == 5


def test_training_stops_when_its_time_is_used():
    figures = list(trainer(Recipe(epochs=50), time_used=itertools.count(0, 0.05).__next__)[1])
    assert 2 <= len(figures) < 7 and figures[-1]["learning_rate"] < 1e-3


def test_a_resumed_training_continues_exactly_as_an_uninterrupted_one():
    recipe = Recipe(epochs=6)
    whole, training = trainer(recipe, iter([6.0, 1.0, 5.0, 4.0, 3.0, 2.0]))
    expected = list(training)
    _, training = trainer(recipe, iter([6.0, 1.0, 5.0]))
    for _ in range(3):
        next(training)
    state = training.state()
    resumed, training = trainer(recipe, iter([4.0, 3.0, 2.0]), seed=9)
    training.restore(state)
    assert training.epoch == 3
    assert list(training) == expected[3:]
    assert same(weights(whole), weights(resumed))


def test_an_average_of_the_weights_is_validated_and_kept_while_training_goes_on_with_the_weights():
    validated = []

    def validation():
        for loss in (3.0, 2.0, 1.0):
            validated.append(weights(network))
            yield loss

    losses = validation()
    network, training = trainer(Recipe(epochs=3, average=0.9), losses)
    alone, plain = trainer(Recipe(epochs=3), iter([3.0, 2.0, 1.0]))
    for _ in range(3):
        next(training), next(plain)
        assert same(weights(network), weights(alone))
    assert list(training) == []
    assert same(weights(network), validated[2]) and not same(weights(network), weights(alone))


def test_a_resumed_training_continues_its_average():
    recipe = Recipe(epochs=4, average=0.9)
    whole, training = trainer(recipe)
    expected = list(training)
    _, training = trainer(recipe)
    next(training), next(training)
    resumed, again = trainer(recipe, seed=9)
    again.restore(training.state())
    assert list(again) == expected[2:] and same(weights(whole), weights(resumed))


def test_a_state_taken_after_the_last_epoch_gives_the_best_weights():
    done, training = trainer(Recipe(epochs=2), iter([1.0, 2.0]))
    next(training), next(training)
    state = training.state()
    other, again = trainer(Recipe(epochs=2), seed=3)
    again.restore(state)
    assert list(again) == [] == list(training)
    assert same(weights(done), weights(other))


@pytest.mark.parametrize("spoil", [lambda state: state[:100], lambda state: b"", lambda state: state[:-9]])
def test_a_damaged_state_is_refused_in_one_line(spoil):
    _, training = trainer(Recipe(epochs=2))
    next(training)
    with pytest.raises(WeightsError, match="cannot be resumed") as raised:
        trainer(Recipe(epochs=2))[1].restore(spoil(training.state()))
    assert "\n" not in str(raised.value)


def test_a_state_of_another_network_is_refused():
    _, training = trainer(Recipe(epochs=2))
    next(training)
    with pytest.raises(WeightsError, match="cannot be resumed"):
        trainer(Recipe(epochs=2), width=6)[1].restore(training.state())


@pytest.mark.parametrize("spoiled", [math.nan, math.inf])
def test_a_loss_that_is_not_finite_ends_the_training_in_one_line_with_its_epoch(spoiled):
    network, training = trainer(Recipe(epochs=5), iter([1.0, spoiled]))
    next(training)
    with pytest.raises(RunError, match=rf"validation loss is {spoiled:g} \(error {spoiled:g}\) in epoch 2; allowed"):
        next(training)
    assert training.epoch == 1
    network, training = trainer(Recipe(epochs=5))
    next(training)
    before = weights(network)
    with torch.no_grad():
        network[0].bias[:] = spoiled
    with pytest.raises(RunError, match=r"^loss is nan .* in epoch 2; allowed is a finite one") as raised:
        next(training)
    assert "\n" not in str(raised.value)
    assert torch.equal(network[3].weight, before["3.weight"])  # no step was taken


def test_the_learning_rate_rises_once_and_falls_to_zero():
    rates = [one_cycle(share) for share in np.linspace(0, 1, 101)]
    assert max(rates) == pytest.approx(1.0, abs=0.01) and rates[-1] == pytest.approx(0, abs=1e-9)
    assert np.argmax(rates) == 20 and (np.diff(rates)[21:] <= 0).all()
