import numpy as np
import torch

from zsdist.vision.labels import FREE_M, expected_openness, nearest, openness, progress, reward_label, sectors
from zsdist.vision.rays import BIN_CENTRES_M, RANGE_M, RAYS, ray_angles_rad

ANGLES = ray_angles_rad(RAYS, np.pi / 2)


def label(clearance, dynamic=(0, 0, 0), bearing=0.0, distance=8.0):
    room = openness(np.array(clearance, np.float32), np.array(dynamic, np.float32), np.float32(distance))
    return reward_label(room, progress(np.float32(bearing), np.float32(distance)))


def test_every_ray_belongs_to_one_direction_and_left_mirrors_right():
    members = sectors(ANGLES)
    assert (members.sum(0) == 1).all() and members.any(1).all()
    np.testing.assert_array_equal(members[1], members[2][::-1])
    assert ANGLES[members[1]].min() > ANGLES[members[0]].max()


def test_the_nearest_obstacle_of_a_direction_gives_its_distance_and_its_kind():
    distance, dynamic = np.full(RAYS, RANGE_M), np.zeros(RAYS, bool)
    distance[2], distance[3], dynamic[3] = 2.0, 1.5, True
    clearance, moving = nearest(distance, dynamic, ANGLES)
    np.testing.assert_allclose(clearance, [RANGE_M, 1.5, RANGE_M])
    np.testing.assert_array_equal(moving, [False, True, False])


def test_eq03_open_ground_towards_the_goal_has_the_highest_label():
    best = label([5, 5, 5])
    assert best.argmax() == 0 and 1.9 < best[0] <= 2.0


def test_eq03_a_near_obstacle_outweighs_the_direction_of_the_goal():
    assert label([0.9, 5, 1.0]).argmax() == 1


def test_eq03_the_goal_decides_between_directions_that_are_equally_open():
    assert label([5, 5, 5], bearing=0.9).argmax() == 1
    assert label([5, 5, 5], bearing=-0.9).argmax() == 2


def test_eq03_a_moving_obstacle_needs_more_clearance_than_a_static_one():
    still, moving = label([2.0] * 3), label([2.0] * 3, dynamic=[1, 1, 1])
    assert (moving < still - 0.3).all()


def test_eq03_grows_with_clearance_and_never_leaves_its_scale():
    rewards = [label([metres] * 3, bearing=2.0)[0] for metres in np.linspace(0, 5, 26)]
    assert (np.diff(rewards) >= 0).all() and rewards[-1] > rewards[0]
    assert min(rewards) >= -2 and max(rewards) <= 2


def test_eq03_obstacles_behind_a_near_goal_do_not_count():
    assert label([1.6, 5, 5], distance=0.6).argmax() == 0
    assert openness(np.float32(1.6), np.float32(0), np.float32(0.6)) == 1.0


def test_progress_is_the_change_of_the_distance_to_the_goal():
    np.testing.assert_allclose(
        progress(np.float32(0), np.float32(100)), [1, np.cos(np.pi / 4), np.cos(np.pi / 4)], atol=0.01
    )
    np.testing.assert_allclose(progress(np.float32(np.pi), np.float32(100))[0], -1, atol=0.01)


def test_the_mean_openness_of_a_certain_distance_is_its_openness():
    sure = np.zeros((1, 3, len(BIN_CENTRES_M)), np.float32)
    sure[:, :, 15] = 1
    dynamic, distance = np.array([[0, 0.5, 1]], np.float32), np.array([7.0], np.float32)
    expected = openness(BIN_CENTRES_M[15], dynamic, distance[:, None])
    np.testing.assert_allclose(expected_openness(sure, BIN_CENTRES_M, dynamic, distance), expected, rtol=1e-5)


def test_tensors_and_arrays_give_the_same_openness():
    rng = np.random.default_rng(0)
    arrays = [
        rng.dirichlet(np.ones(len(BIN_CENTRES_M)), (4, 3)).astype(np.float32),
        BIN_CENTRES_M,
        rng.random((4, 3), np.float32),
        rng.uniform(0.3, FREE_M * 2, 4).astype(np.float32),
    ]
    ours = expected_openness(*(torch.from_numpy(array) for array in arrays))
    np.testing.assert_allclose(ours.numpy(), expected_openness(*arrays), rtol=1e-5)
