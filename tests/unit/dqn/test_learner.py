from dataclasses import replace

import numpy as np
import pytest
import torch
from learner_batches import ACTIONS, MIRROR, STATE_SIZE, batch, same_arrays

from zsdist.config import LevelConfig
from zsdist.dqn import network, torch_network
from zsdist.dqn.fused import FusedDqnLearner
from zsdist.dqn.learner import DqnLearner
from zsdist.errors import RunError, WeightsError
from zsdist.types import Batch

CONFIG = LevelConfig(hidden=(16, 16), guide_margin_weight=0.5)


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(params=[DqnLearner, FusedDqnLearner])
def learner(request):
    """Return a function that makes learners of one kind."""

    def make(config=CONFIG, seed=0, mirror=None, state_size=STATE_SIZE, actions=ACTIONS, device="cpu"):
        return request.param(state_size, actions, config, seed, mirror=mirror, device=device)

    return make


def updated(dqn, data):
    """Return the figures of one update."""
    dqn.update(data)
    return dqn.figures()


def gradient_of_first_step(dqn):
    """Return the gradient, from Adam's first moment, which is a tenth of it."""
    return torch.from_numpy(dqn.state()["adam/exp_avg"] * 10)


def test_eq11_an_update_moves_the_value_of_the_action_towards_its_target(learner):
    config = LevelConfig(hidden=(16,), target_tau=0)
    dqn = learner(config)
    data = batch(0)
    data.discounts[:] = 0  # so that the target is the reward

    def error():
        q = network.apply(dqn.parameters(), data.states)
        return np.abs(q[np.arange(len(data)), data.actions] - data.rewards).mean()

    before = error()
    for _ in range(300):
        dqn.update(data)
    assert error() < 0.25 * before


def test_eq11_its_first_step_follows_the_sign_of_the_gradient(learner):
    dqn = learner(LevelConfig(hidden=(), target_tau=0, huber=False, max_gradient_norm=1e9))
    before, data = dqn.parameters(), batch(1)
    q = network.apply(before, data.states)
    next_best = network.apply(before, data.next_states).max(axis=1)
    rows = np.arange(len(data))
    error = data.rewards + data.discounts * next_best - q[rows, data.actions]
    expected = np.zeros((ACTIONS, STATE_SIZE))
    np.add.at(expected, data.actions, error[:, None] * data.states)
    dqn.update(data)
    moved = dqn.parameters()["output.weight"] - before["output.weight"]
    clear = np.abs(expected) > 1e-3
    assert clear.any() and (np.sign(moved[clear]) == np.sign(expected[clear])).all()


def test_eq11_the_gradient_is_that_of_the_losses_through_the_network_as_recorded_by_torch(learner):
    data = batch(4)
    config = LevelConfig(hidden=(16, 12), guide_margin_weight=0.3, max_gradient_norm=1e9)
    dqn = learner(config)
    network_t = torch_network.policy_network(dqn.parameters())
    q, q_tp1, q_target = (
        network_t(torch.from_numpy(data.states)),
        network.apply(dqn.parameters(), data.next_states),
        network.apply(dqn.target_parameters(), data.next_states),
    )
    targets = data.rewards + data.discounts * q_target[np.arange(len(data)), q_tp1.argmax(1)]
    loss = torch.nn.functional.smooth_l1_loss(
        q.gather(1, torch.from_numpy(data.actions)[:, None])[:, 0], torch.from_numpy(targets)
    )
    guided = q[:, 0]
    lifted = torch.cat([guided[:, None], q[:, 1:] + config.guide_margin], 1)
    lifted = lifted.masked_fill(torch.from_numpy(~data.masks), -torch.inf)
    loss = loss + 0.3 * torch.where(torch.from_numpy(data.guides == 0), lifted.amax(1) - guided, 0.0).mean()
    loss.backward()
    figures = updated(dqn, data)
    assert figures["loss"] == pytest.approx(loss.item(), rel=1e-5)
    expected = torch.cat([tensor.grad.reshape(-1) for tensor in network_t.tensors])
    torch.testing.assert_close(gradient_of_first_step(dqn), expected, rtol=1e-4, atol=1e-6)


def test_eq11_rows_drawn_by_priority_count_as_much_as_their_weights(learner):
    config, data = LevelConfig(hidden=(16,), guide_margin_weight=0.3, max_gradient_norm=1e9), batch(4)
    weights = np.random.default_rng(0).integers(1, 4, len(data)) / np.float32(4)
    repeated = np.repeat(np.arange(len(data)), (4 * weights).astype(int))
    weighted, plain = learner(config), learner(config)
    weighted.update(replace(data, weights=weights.astype(np.float32), serials=np.arange(len(data))))
    plain.update(Batch(**{name: column[repeated] for name, column in vars(data).items() if column is not None}))
    ratio = len(repeated) / (4 * len(data))  # the mean is over all rows, whatever their weights
    torch.testing.assert_close(
        gradient_of_first_step(weighted), ratio * gradient_of_first_step(plain), rtol=1e-4, atol=1e-6
    )


def test_errors_are_those_of_the_last_update_before_it(learner):
    dqn, data = learner(LevelConfig(hidden=(), target_tau=0)), batch(1)
    with pytest.raises(RunError, match="make an update first"):
        dqn.errors()
    q = network.apply(dqn.parameters(), data.states)[np.arange(len(data)), data.actions]
    best = network.apply(dqn.parameters(), data.next_states).max(axis=1)
    dqn.update(data)
    np.testing.assert_allclose(dqn.errors(), np.abs(data.rewards + data.discounts * best - q), rtol=1e-4, atol=1e-5)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_learns_what_the_cpu_learns(learner):
    here, there = learner(mirror=MIRROR), learner(mirror=MIRROR, device="cuda")
    for seed in range(20):
        here.update(batch(seed))
        there.update(batch(seed))
    for name, value in here.parameters().items():
        np.testing.assert_allclose(there.parameters()[name], value, atol=1e-3)


def test_before_any_update_there_are_no_figures(learner):
    assert learner().figures() == {}


def test_a_learner_finds_the_optimal_values_of_a_small_chain(learner):
    # Five cells in a row; action 1 goes right, action 0 left; the right end gives reward 1 and ends the episode.
    config = LevelConfig(hidden=(32,), discount=0.9, target_tau=0.05)
    dqn = learner(config, state_size=5, actions=2)
    cells = np.repeat(np.arange(4), 2)
    actions = np.tile([0, 1], 4)
    following = np.clip(cells + 2 * actions - 1, 0, 4)
    eye = np.eye(5, dtype=np.float32)
    done = following == 4
    data = Batch(
        states=eye[cells],
        actions=actions,
        rewards=done.astype(np.float32),
        discounts=np.where(done, 0, 0.9).astype(np.float32),
        next_states=eye[following],
        next_masks=np.ones((8, 2), bool),
        masks=np.ones((8, 2), bool),
        guides=np.full(8, -1),
    )
    for _ in range(800):
        dqn.update(data)
    values = network.apply(dqn.parameters(), eye[:4]).max(axis=1)
    np.testing.assert_allclose(values, 0.9 ** np.array([3, 2, 1, 0]), atol=0.05)


def test_equal_seeds_and_batches_give_equal_bits(learner):
    one, other = learner(mirror=MIRROR), learner(mirror=MIRROR)
    for seed in range(10):
        assert updated(one, batch(seed)) == updated(other, batch(seed))
    assert same_arrays(one.state(), other.state())
    assert network.sha256(learner(seed=1).parameters()) != network.sha256(learner(seed=2).parameters())


@pytest.mark.parametrize("stop", [0, 7])
def test_a_restored_learner_continues_bit_for_bit_as_if_it_had_never_stopped(learner, stop):
    straight, stopped = learner(mirror=MIRROR), learner(mirror=MIRROR)
    for seed in range(stop):
        straight.update(batch(seed))
        stopped.update(batch(seed))
    resumed = learner(seed=99, mirror=MIRROR)
    resumed.update(batch(1000))
    resumed.restore(stopped.state())
    for seed in range(stop, stop + 8):
        assert updated(straight, batch(seed)) == updated(resumed, batch(seed))
    assert same_arrays(straight.state(), resumed.state()) and resumed.updates == stop + 8


def test_a_state_is_a_copy_that_later_updates_do_not_touch(learner):
    dqn = learner()
    state, parameters = dqn.state(), dqn.parameters()
    kept = {name: value.copy() for name, value in state.items()}
    dqn.update(batch(0))
    assert same_arrays(state, kept) and same_arrays(parameters, {n: kept[f"online/{n}"] for n in parameters})


def test_a_damaged_state_is_refused_by_name(learner):
    state = learner().state()
    with pytest.raises(RunError, match="adam/exp_avg is missing"):
        learner().restore({name: value for name, value in state.items() if name != "adam/exp_avg"})
    with pytest.raises(WeightsError, match=r"hidden0\.weight"):
        wider = learner(state_size=STATE_SIZE + 1).state()
        learner().restore({**state, **{name: value for name, value in wider.items() if name.startswith("online/")}})


def test_the_target_network_follows_by_tau_and_stands_still_without(learner):
    for tau in (0.0, 0.25, 1.0):
        dqn = learner(LevelConfig(hidden=(16,), target_tau=tau))
        before = dqn.target_parameters()
        dqn.update(batch(0))
        after, online = dqn.target_parameters(), dqn.parameters()
        for name, value in after.items():
            np.testing.assert_allclose(value, before[name] + tau * (online[name] - before[name]), atol=1e-6)


def test_the_reward_scale_scales_what_is_learned(learner):
    one, scaled = learner(LevelConfig(hidden=())), learner(LevelConfig(hidden=(), reward_scale=0.01))
    data = batch(0)
    smaller = Batch(**{**data.__dict__, "rewards": data.rewards * np.float32(0.01)})
    assert updated(one, smaller)["loss"] == pytest.approx(updated(scaled, data)["loss"], rel=1e-5)


def test_no_step_is_larger_than_the_clipped_gradient_allows_and_the_norm_is_reported_unclipped(learner):
    data = batch(0)
    data.rewards[:] = 1e4
    free = learner(LevelConfig(hidden=(), huber=False, max_gradient_norm=1e9, target_tau=0))
    clipped = learner(LevelConfig(hidden=(), huber=False, max_gradient_norm=1e-3, target_tau=0))
    assert updated(free, data)["gradient_norm"] == updated(clipped, data)["gradient_norm"] > 1e3
    for dqn, norm in ((free, None), (clipped, 1e-3)):
        moment = np.linalg.norm(dqn.state()["adam/exp_avg"]) / 0.1
        assert moment > 1e3 if norm is None else moment == pytest.approx(norm, rel=1e-3)


def test_the_margin_weight_teaches_the_guide_action_without_reward(learner):
    dqn = learner(LevelConfig(hidden=(32,), guide_margin_weight=1.0))
    data = batch(3, size=128)
    data.rewards[:] = 0
    data.guides[:] = 0
    for _ in range(200):
        dqn.update(data)
    assert (network.greedy(network.apply(dqn.parameters(), data.states), data.masks) == 0).mean() > 0.95


def test_distilling_moves_a_copy_towards_the_guide_and_leaves_the_learner_untouched(learner):
    dqn = learner(LevelConfig(hidden=(32,)), mirror=None)
    for seed in range(5):
        dqn.update(batch(seed))
    before = dqn.state()
    data = batch(9, size=128)
    data.guides[:] = 0
    student = dqn.distilled([data] * 200)

    def agreement(parameters):
        return (network.greedy(network.apply(parameters, data.states), data.masks) == 0).mean()

    assert agreement(student) > max(0.9, agreement(dqn.parameters()))
    assert same_arrays(before, dqn.state())


def test_distilling_does_not_change_what_the_learner_does_next(learner):
    one, other = learner(mirror=MIRROR), learner(mirror=MIRROR)
    one.update(batch(0))
    other.update(batch(0))
    one.distilled([batch(5)] * 3)
    assert updated(one, batch(1)) == updated(other, batch(1))
    assert same_arrays(one.state(), other.state())


def test_promoting_the_recent_network_moves_the_target_only(learner):
    dqn = learner()
    dqn.update(batch(0))
    before = dqn.state()
    dqn.promote(dqn.parameters(), reset_online=False)
    after = dqn.state()
    assert same_arrays(dqn.target_parameters(), dqn.parameters())
    assert all(np.array_equal(after[name], before[name]) for name in before if not name.startswith("target/"))


def test_promoting_another_network_replaces_both_and_restarts_the_optimiser(learner):
    dqn, winner = learner(), learner(seed=5).parameters()
    dqn.update(batch(0))
    dqn.promote(winner, reset_online=True)
    assert same_arrays(dqn.parameters(), winner) and same_arrays(dqn.target_parameters(), winner)
    state = dqn.state()
    assert state["adam/step"] == 0 and not state["adam/exp_avg"].any() and not state["adam/exp_avg_sq"].any()
    dqn.update(batch(1))
    assert not same_arrays(dqn.parameters(), winner)


def test_weights_of_another_network_are_not_promoted(learner):
    stranger = network.initial_parameters(STATE_SIZE, ACTIONS, (8, 16), 0)
    with pytest.raises(WeightsError, match=r"hidden0\.weight"):
        learner().promote(stranger, reset_online=True)


def test_with_a_mirror_left_is_learned_from_right(learner):
    dqn = learner(LevelConfig(hidden=(32,)), mirror=MIRROR)
    data = batch(0, size=64)
    data.actions[:], data.discounts[:], data.rewards[:] = 1, 0, 1.0
    for _ in range(300):
        dqn.update(data)
    mirrored = data.states[:, MIRROR.state_index] * MIRROR.state_sign
    np.testing.assert_allclose(network.apply(dqn.parameters(), mirrored)[:, 2], 1.0, atol=0.2)
