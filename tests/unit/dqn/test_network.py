import numpy as np
import pytest
import torch

from zsdist.dqn import network, torch_network
from zsdist.errors import WeightsError

STATE_SIZE, ACTIONS = 40, 5


def trained_looking(hidden=(32, 16), seed=0):
    rng = np.random.default_rng(seed)
    parameters = network.initial_parameters(STATE_SIZE, ACTIONS, hidden, seed)
    return {name: (value + 0.2 * rng.normal(size=value.shape)).astype(np.float32) for name, value in parameters.items()}


@pytest.mark.parametrize("hidden", [(), (24,), (128, 128)])
def test_eq08_the_policy_network_is_what_actors_compute_without_torch(hidden):
    parameters = trained_looking(hidden)
    states = np.random.default_rng(1).normal(size=(64, STATE_SIZE)).astype(np.float32)
    with torch.no_grad():
        q = torch_network.policy_network(parameters)(torch.from_numpy(states)).numpy()
    acted = network.apply(parameters, states)
    assert acted.shape == (64, ACTIONS) and acted.dtype == np.float32
    np.testing.assert_allclose(acted, q, rtol=1e-5, atol=1e-5)


def test_eq09_the_target_network_has_parameters_of_its_own_and_takes_no_gradient():
    parameters = trained_looking()
    policy, target = torch_network.policy_network(parameters), torch_network.target_network(parameters)
    assert all(tensor.requires_grad for tensor in policy.tensors)
    assert not any(tensor.requires_grad for tensor in target.tensors)
    with torch.no_grad():
        policy.tensors[0].zero_()
    np.testing.assert_array_equal(target.parameters_numpy()["hidden0.weight"], parameters["hidden0.weight"])


def test_acting_leaves_states_and_parameters_as_they_were():
    parameters = trained_looking()
    states = np.ones((3, STATE_SIZE), np.float32)
    before = network.sha256(parameters)
    network.apply(parameters, states)
    assert (states == 1).all() and network.sha256(parameters) == before


def test_initial_parameters_repeat_with_the_seed_and_value_everything_near_zero():
    one, same, other = (network.initial_parameters(STATE_SIZE, ACTIONS, (32,), seed) for seed in (3, 3, 4))
    assert network.sha256(one) == network.sha256(same) != network.sha256(other)
    states = np.random.default_rng(0).normal(size=(100, STATE_SIZE)).astype(np.float32)
    assert np.abs(network.apply(one, states)).max() < 1.5


def test_greedy_takes_the_best_allowed_action_and_the_first_of_equals():
    q = np.array([[1.0, 9.0, 2.0], [5.0, 5.0, 5.0], [-3.0, -2.0, -1.0]], np.float32)
    mask = np.array([[True, False, True], [False, True, True], [True, True, False]])
    assert network.greedy(q, mask).tolist() == [2, 1, 1]


def test_greedy_refuses_a_row_that_allows_nothing():
    with pytest.raises(ValueError, match="row 1 of the mask allows no action"):
        network.greedy(np.zeros((2, 3)), np.array([[True, False, False], [False, False, False]]))


def test_check_accepts_networks_of_any_widths():
    for hidden in ((), (7,), (128, 64, 3)):
        network.check(network.initial_parameters(STATE_SIZE, ACTIONS, hidden, 0), STATE_SIZE, ACTIONS)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: p.pop("output.bias"), "named"),
        (lambda p: p.update(extra=np.zeros(1, np.float32)), "extra"),
        (lambda p: p.pop("hidden1.norm_scale"), "named"),
        (lambda p: p.update({"hidden0.weight": p["hidden0.weight"][:, :-1]}), r"hidden0.weight .*\(32, 39\)"),
        (lambda p: p.update({"output.bias": p["output.bias"].astype(np.float64)}), "output.bias is float64"),
        (lambda p: p["hidden1.weight"].__setitem__((0, 0), np.nan), "hidden1.weight holds values that are not finite"),
    ],
)
def test_check_names_the_weight_that_is_wrong(spoil, message):
    parameters = network.initial_parameters(STATE_SIZE, ACTIONS, (32, 16), 0)
    spoil(parameters)
    with pytest.raises(WeightsError, match=message):
        network.check(parameters, STATE_SIZE, ACTIONS)


def test_the_hash_ignores_the_order_of_names_and_sees_every_value():
    parameters = trained_looking()
    assert network.sha256(dict(reversed(parameters.items()))) == network.sha256(parameters)
    changed = {name: value.copy() for name, value in parameters.items()}
    changed["output.weight"][-1, -1] = np.nextafter(changed["output.weight"][-1, -1], np.float32(9))
    assert network.sha256(changed) != network.sha256(parameters)
