from dataclasses import replace

import numpy as np
import pytest
import torch
from learner_batches import ACTIONS, MIRROR, STATE_SIZE, batch

from zsdist.config import LevelConfig
from zsdist.dqn import network, torch_network
from zsdist.dqn.fused import FusedDqnLearner, backward, forward
from zsdist.dqn.learner import DqnLearner

# The two learners round float32 in different orders, so weights near 1 differ by about 2e-7. They stay that close over
# 100 updates unless rounding switches a ReLU or the strongest rival of a guide action. That happens about once in
# 3,000 updates and changes a part of one Adam step (0.002); the difference grew to 7e-4 by the 100th update. A wrong
# term in a gradient moves weights by 1e-3 in the first update already.
TOLERANCES = {10: 1e-5, 100: 2e-3}  # after so many updates


@pytest.mark.parametrize("prioritised", [False, True])
@pytest.mark.parametrize("mirror", [None, MIRROR])
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"double": False},
        {"huber": False},
        {"guide_margin_weight": 0.0},
        {"max_gradient_norm": 0.05},
        {"double": False, "huber": False, "guide_margin_weight": 0.0},
        {"hidden": ()},
    ],
)
def test_the_fused_learner_computes_what_the_reference_does(settings, mirror, prioritised):
    config = LevelConfig(**({"hidden": (24, 16)} | settings))
    learners = [kind(STATE_SIZE, ACTIONS, config, 0, mirror, "cpu") for kind in (DqnLearner, FusedDqnLearner)]
    weights = np.linspace(0.1, 1.0, 32, dtype=np.float32)
    for seed in range(max(TOLERANCES)):
        data = batch(seed)
        if prioritised:
            data = replace(data, weights=weights, serials=np.arange(32))
        for learner in learners:
            learner.update(data)
        if learners[0].updates in TOLERANCES:
            check_equal(*learners, data, TOLERANCES[learners[0].updates])


def check_equal(reference, fused, data, tolerance):
    close = {"rtol": tolerance, "atol": tolerance}
    np.testing.assert_allclose(fused.errors(), reference.errors(), **close)
    assert fused.figures() == pytest.approx(reference.figures(), rel=tolerance, abs=tolerance)
    expected, found = reference.state(), fused.state()
    np.testing.assert_array_equal(found.pop("generator"), expected.pop("generator"))
    assert_close(found, expected, close)
    assert_close(fused.distilled([data] * 3), reference.distilled([data] * 3), close)


def assert_close(found, expected, close):
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, err_msg=name, **close)


def test_each_learner_resumes_from_the_state_of_the_other():
    config = LevelConfig(hidden=(16,))
    for kind, other in ((DqnLearner, FusedDqnLearner), (FusedDqnLearner, DqnLearner)):
        first, second = (
            each(STATE_SIZE, ACTIONS, config, seed, None, "cpu") for seed, each in enumerate((kind, other))
        )
        for seed in range(5):
            first.update(batch(seed))
        second.restore(first.state())
        for learner in (first, second):
            learner.update(batch(9))
        assert_close(second.parameters(), first.parameters(), {"atol": 1e-5})


@pytest.mark.parametrize("hidden", [(), (24,), (32, 16)])
def test_the_backward_pass_writes_the_gradients_that_automatic_differentiation_finds(hidden):
    rng = np.random.default_rng(0)
    parameters = network.initial_parameters(STATE_SIZE, ACTIONS, hidden, 0)
    by_hand, recorded = (torch_network.policy_network(parameters) for _ in range(2))
    for tensor in by_hand.tensors:
        tensor.grad = torch.zeros_like(tensor)
    states = torch.from_numpy(rng.normal(size=(20, STATE_SIZE)).astype(np.float32))
    gradient = torch.from_numpy(rng.normal(size=(12, ACTIONS)).astype(np.float32))
    with torch.no_grad():
        values, trace = forward(by_hand, states)
        backward(by_hand, gradient, trace)
    expected = recorded(states)
    torch.testing.assert_close(values, expected.detach())
    (expected[:12] * gradient).sum().backward()
    for one, other in zip(by_hand.tensors, recorded.tensors, strict=True):
        torch.testing.assert_close(one.grad, other.grad, rtol=1e-4, atol=1e-6)
