import numpy as np
import pytest

from zsdist.vision.scores import action_scores, depth_rays_m, ray_scores

LABELS = np.array([[2.0, 0.0, -1.0], [0.0, 1.0, 1.0]])


def test_the_labels_themselves_score_best():
    assert action_scores(LABELS, LABELS) == {"best_action_accuracy": 1.0, "regret": 0.0, "mae": 0.0}


def test_a_wrong_choice_costs_what_it_loses_and_a_tie_costs_nothing():
    said = np.array([[0.0, 5.0, 0.0], [0.0, 0.0, 5.0]])
    found = action_scores(said, LABELS)
    assert found["best_action_accuracy"] == 0.5 and found["regret"] == pytest.approx(1.0)


def test_misses_and_false_alarms_are_shares_of_the_rays_where_they_could_happen():
    true = np.array([[1.0, 1.0, 4.0, 4.0, 2.0]])
    said = np.array([[3.0, 1.2, 1.0, 4.0, 0.1]])
    assert ray_scores(said, true) == {"miss_rate": 0.5, "false_alarm_rate": 0.5}


def wall(px=64, at_m=2.0):
    """A depth image of flat ground from 1 m up, with a wall 2 m tall ahead of its left half."""
    down = -(1 - 2 * (np.arange(px) + 0.5) / px)
    depth = np.where(down > 0, 1 / np.maximum(down, 1e-9), np.inf)[:, None].repeat(px, 1)
    depth[:, : px // 2] = np.minimum(depth[:, : px // 2], at_m)
    return depth


def test_a_depth_image_tells_walls_from_ground():
    rays = depth_rays_m(wall(), 32, np.pi / 2, 1.0, 5.0, 1.5)
    np.testing.assert_allclose(rays[16:], 5.0)
    assert rays[15] == pytest.approx(2.0, abs=0.02)
    assert rays[0] == pytest.approx(2.0 * np.sqrt(2), abs=0.1)


def test_what_hangs_above_the_car_is_not_in_its_way():
    depth = wall()
    depth[20:, :32] = wall(at_m=50.0)[20:, :32]  # only what is above the camera's height by 0.7 m or more is left
    assert (depth_rays_m(depth, 32, np.pi / 2, 1.0, 5.0, 1.5) == 5.0).all()
