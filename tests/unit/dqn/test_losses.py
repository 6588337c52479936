import numpy as np
import pytest

from zsdist.dqn import losses


def floats(*rows):
    return np.array(rows, np.float32)


REWARD = floats(1.0, -2.0)
DISCOUNT = floats(0.9, 0.5)
TARGET_Q = floats([10.0, 20.0, 30.0], [4.0, 8.0, 6.0])
ALL = np.ones((2, 3), bool)


def test_eq10_the_target_is_the_reward_and_the_discounted_best_next_value():
    targets = losses.td_targets(REWARD, DISCOUNT, TARGET_Q, ALL)
    np.testing.assert_allclose(targets, floats(*[1 + 0.9 * 30, -2 + 0.5 * 8]))


def test_eq10_has_no_bootstrap_at_goal_and_collision_even_with_no_next_action():
    nothing = np.zeros((2, 3), bool)
    assert np.array_equal(losses.td_targets(REWARD, floats(0.0, 0.0), TARGET_Q, nothing), REWARD)


def test_eq10_never_bootstraps_from_an_action_that_is_not_allowed():
    mask = np.array([[True, True, False], [True, False, False]])
    targets = losses.td_targets(REWARD, DISCOUNT, TARGET_Q, mask)
    np.testing.assert_allclose(targets, floats(*[1 + 0.9 * 20, -2 + 0.5 * 4]))


def test_double_learning_lets_the_policy_network_choose_and_the_target_network_value():
    online_q = floats([3.0, 2.0, 1.0], [0.0, 9.0, 5.0])
    mask = np.array([[True, True, True], [True, False, True]])
    targets = losses.td_targets(REWARD, DISCOUNT, TARGET_Q, mask, online_q)
    np.testing.assert_allclose(targets, floats(*[1 + 0.9 * 10, -2 + 0.5 * 6]))


def test_both_losses_have_the_temporal_difference_as_gradient_and_huber_bounds_it():
    q, actions, targets = floats([0.0, 5.0], [1.0, 0.0]), np.array([0, 0]), floats(0.5, 11.0)
    errors = losses.td_error(q, actions, targets)
    np.testing.assert_allclose(errors, floats(-0.5, -10.0))
    square, gradient = losses.td_loss(errors, huber=False), losses.td_gradient(q, actions, errors, huber=False)
    assert square == pytest.approx((0.125 + 50.0) / 2)
    np.testing.assert_allclose(gradient, floats([-0.25, 0.0], [-5.0, 0.0]))
    huber, gradient = losses.td_loss(errors, huber=True), losses.td_gradient(q, actions, errors, huber=True)
    assert huber == pytest.approx((0.125 + 9.5) / 2)
    np.testing.assert_allclose(gradient, floats([-0.25, 0.0], [-0.5, 0.0]))


def test_gradients_are_those_that_differences_of_the_losses_show():
    rng = np.random.default_rng(0)
    q, masks = rng.normal(size=(40, 5)).astype(np.float32), rng.random((40, 5)) < 0.7
    masks[:, 0] = True
    choices, targets = rng.integers(0, 5, 40), rng.normal(size=40).astype(np.float32)
    guides = rng.integers(-1, 5, 40)

    def td(values, targets, huber):
        errors = losses.td_error(values, choices, targets)
        return losses.td_loss(errors, huber), losses.td_gradient(values, choices, errors, huber)

    def margin(values):
        given = (values, masks, guides, 0.3)
        return losses.margin_loss(*given), losses.margin_gradient(*given)

    for loss in (lambda values: td(values, 2 * targets, True), lambda values: td(values, targets, False), margin):
        at, gradient = loss(q)
        direction = rng.normal(size=(40, 5)).astype(np.float32)
        moved = (loss(q + np.float32(1e-3) * direction)[0] - at) / 1e-3
        assert moved == pytest.approx((gradient * direction).sum(), abs=5e-3)
        assert np.abs(gradient).sum() > 0.1


def test_the_margin_loss_is_zero_only_when_the_guide_leads_every_allowed_action_by_the_margin():
    q = floats([2.0, 1.0, 9.0])
    mask = np.array([[True, True, False]])
    guide = np.array([0])
    assert losses.margin_loss(q, mask, guide, margin=1.0) == 0.0
    assert losses.margin_loss(q, mask, guide, margin=1.5) == pytest.approx(0.5)
    assert losses.margin_loss(q, mask, np.array([1]), margin=0.5) == pytest.approx(1.5)


def test_the_margin_loss_pushes_the_guide_up_and_its_strongest_rival_down():
    q = floats([0.0, 1.0, 0.5])
    gradient = losses.margin_gradient(q, np.ones((1, 3), bool), np.array([0]), 0.8)
    np.testing.assert_allclose(gradient, floats([-1.0, 1.0, 0.0]))


def test_rows_without_an_allowed_guide_action_count_nothing_but_keep_their_share():
    q = floats([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0])
    mask = np.array([[True, True], [True, True], [False, True], [False, False]])
    given = (q, mask, np.array([0, -1, 0, -1]), 0.5)
    loss, gradient = losses.margin_loss(*given), losses.margin_gradient(*given)
    assert loss == pytest.approx(1.5 / 4)
    assert not gradient[1:].any() and np.isfinite(gradient).all()


@pytest.mark.parametrize(
    "arguments",
    [
        (REWARD[:, None], DISCOUNT, TARGET_Q, ALL),
        (REWARD.astype(float), DISCOUNT, TARGET_Q, ALL),
        (REWARD, DISCOUNT, TARGET_Q[0], ALL),
        (REWARD, DISCOUNT, TARGET_Q, ALL.astype(np.float32)),
    ],
)
def test_wrong_ranks_and_dtypes_are_caught_instead_of_broadcast(arguments):
    with pytest.raises(AssertionError):
        losses.td_targets(*arguments)
