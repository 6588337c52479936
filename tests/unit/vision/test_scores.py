import numpy as np
import pytest

from zsdist.vision.scores import action_scores, calibration, depth_rays_m, ray_scores, unseen_objects

LABELS = np.array([[2.0, 0.0, -1.0], [0.0, 1.0, 1.0]])


def test_the_true_labels_score_best():
    assert action_scores(LABELS, LABELS) == {"best_action_accuracy": 1.0, "regret": 0.0, "mae": 0.0}


def test_a_wrong_choice_costs_its_loss_of_reward_and_a_tie_costs_nothing():
    predicted = np.array([[0.0, 5.0, 0.0], [0.0, 0.0, 5.0]])
    found = action_scores(predicted, LABELS)
    assert found["best_action_accuracy"] == 0.5 and found["regret"] == pytest.approx(1.0)


def test_misses_and_false_alarms_are_shares_of_the_rays_that_allow_them():
    true = np.array([[1.0, 1.0, 4.0, 4.0, 2.0]])
    predicted = np.array([[3.0, 1.2, 1.0, 4.0, 0.1]])
    assert ray_scores(predicted, true) == {"miss_rate": 0.5, "false_alarm_rate": 0.5}


def test_calibration_counts_truths_below_the_quantile_among_rays_below_the_range():
    predicted = np.array([[1.0, 2.0, 3.0, 4.0, 5.0]])
    true = np.array([[0.5, 2.5, 3.5, 4.5, 4.0]])
    assert calibration(predicted, true, 5.0) == {"short": 0.25, "all": 0.4, "rays": 4}
    assert np.isnan(calibration(np.full((1, 3), 5.0), np.full((1, 3), 5.0), 5.0)["short"])


def test_an_object_is_unseen_only_if_each_of_its_rays_is_predicted_much_longer():
    objects = np.array([[0, 0, 1, 1, 2, 3, 3, -1, -2, -2]])
    true = np.array([[2.0, 2.2, 1.0, 1.1, 1.0, 3.0, 3.0, 5.0, 1.0, 1.0]])
    predicted = np.array([[3.2, 3.3, 2.5, 1.2, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0]])
    # 0 is unseen; 1 is seen on one ray; 2 is on one ray only; 3 is too far; walls and free rays are no objects
    assert unseen_objects(objects, predicted, true) == (2, 1)


def test_the_same_number_in_two_pictures_is_two_objects():
    objects, true = np.zeros((2, 4), int), np.full((2, 4), 1.5)
    assert unseen_objects(objects, np.stack([np.full(4, 5.0), true[0]]), true) == (2, 1)


def wall(px=64, at_m=2.0):
    """Return a depth image of flat ground from a height of 1 m, with a wall 2 m tall ahead in its left half."""
    down = -(1 - 2 * (np.arange(px) + 0.5) / px)
    depth = np.where(down > 0, 1 / np.maximum(down, 1e-9), np.inf)[:, None].repeat(px, 1)
    depth[:, : px // 2] = np.minimum(depth[:, : px // 2], at_m)
    return depth


def test_rays_of_a_depth_image_end_at_walls_and_not_on_the_ground():
    rays = depth_rays_m(wall(), 32, np.pi / 2, 1.0, 5.0, 1.5)
    np.testing.assert_allclose(rays[16:], 5.0)
    assert rays[15] == pytest.approx(2.0, abs=0.02)
    assert rays[0] == pytest.approx(2.0 * np.sqrt(2), abs=0.1)


def test_surfaces_above_the_car_do_not_obstruct():
    depth = wall()
    depth[20:, :32] = wall(at_m=50.0)[20:, :32]  # only points 0.7 m or more above the camera are left
    assert (depth_rays_m(depth, 32, np.pi / 2, 1.0, 5.0, 1.5) == 5.0).all()
