import math

import numpy as np
import pytest

from zsdist.vision.labels import progress
from zsdist.vision.masks import (
    CHANGED_REWARD,
    MOST_MASKS,
    choose_masks,
    hide,
    labels_changed,
    pixel_distance_m,
    rewards,
)
from zsdist.vision.rays import RAYS, ray_angles_rad

PX = 40
ANGLES = ray_angles_rad(RAYS, math.pi / 2)


def picture(objects, ground_rows=slice(20, None), far_rows=slice(15, 20)):
    """Return a picture with sky above, background at 9 m, ground at 2 m, and `objects` of (rows, columns, distance)."""
    instances, distance = np.full((PX, PX), -9), np.full((PX, PX), np.inf)
    ground = np.zeros((PX, PX), bool)
    ground[ground_rows] = True
    distance[ground_rows], distance[far_rows] = 2.0, 9.0
    for number, (rows, columns, metres) in enumerate(objects):
        instances[rows, columns], distance[rows, columns], ground[rows, columns] = number, metres, False
    return instances, distance, ground, ~np.isfinite(distance)


def test_a_near_object_has_a_mask_of_its_own_shape():
    place = slice(18, 30), slice(5, 12)
    arrays = picture([(*place, 1.5)])
    objects, _ = choose_masks(*arrays, 5.0)
    assert list(objects) == [0]
    assert (objects[0] == (arrays[0] == 0)).all()


def test_far_objects_have_no_mask_of_their_own_but_are_background():
    arrays = picture([(slice(12, 25), slice(5, 12), 7.0)])
    objects, background = choose_masks(*arrays, 5.0)
    assert objects == {}
    assert any(mask[arrays[0] == 0].all() for mask in background)


def test_trivial_objects_are_left_out():
    objects, _ = choose_masks(*picture([(slice(20, 21), slice(5, 6), 1.0)]), 5.0)
    assert objects == {}


def test_an_object_that_fills_the_picture_is_left_out():
    objects, background = choose_masks(*picture([(slice(None), slice(None), 0.5)]), 5.0)
    assert objects == {} and background == []


def test_background_is_sky_far_objects_and_ground_at_left_middle_and_right():
    arrays = picture([(slice(18, 30), slice(5, 12), 1.5)])
    ground, sky = arrays[2:]
    objects, background = choose_masks(*arrays, 5.0)
    assert len(background) == 5
    assert (np.sum([*background, objects[0]], axis=0) == 1).all()  # each pixel is hidden once
    assert sum((mask & ground).any() for mask in background) == 3
    assert sum((mask == sky).all() for mask in background) == 1


def test_there_are_at_most_sixteen_masks_and_the_largest_objects_keep_theirs():
    grown = [(slice(30, 32 + k // 8), slice(2 * (k % 20), 2 * (k % 20) + 2), 1.0) for k in range(20)]
    objects, background = choose_masks(*picture(grown), 5.0)
    assert len(objects) + len(background) == MOST_MASKS == 16
    assert min(objects) > 20 - len(objects) - 8 and {16, 17, 18, 19} <= set(objects)


def test_hiding_fills_with_the_mean_of_the_rest_and_leaves_the_rest():
    image = np.random.default_rng(0).integers(0, 256, (PX, PX, 3), np.uint8)
    hidden = np.zeros((PX, PX), bool)
    hidden[5:9, 3:20] = True
    result = hide(image, hidden)
    assert (result[~hidden] == image[~hidden]).all()
    np.testing.assert_allclose(result[hidden], np.tile(image[~hidden].mean(0), (hidden.sum(), 1)), atol=0.5)
    assert (hide(image, np.zeros((PX, PX), bool)) == image).all()


@pytest.mark.parametrize("hidden", [np.zeros((PX, PX)), np.zeros((PX, 3), bool), np.ones((PX, PX), bool)])
def test_a_mask_that_does_not_fit_the_picture_is_refused_in_one_line(hidden):
    with pytest.raises(ValueError, match="mask") as error:
        hide(np.zeros((PX, PX, 3), np.uint8), hidden)
    assert "\n" not in str(error.value)


def test_a_label_changes_only_in_the_direction_of_the_removed_object():
    free = np.full((1, RAYS), 5.0, np.float32)
    blocked = free.copy()
    blocked[:, :8] = 1.2  # at the left
    still = np.zeros((1, RAYS), bool)
    goal_m = np.array([6.0])
    gain = progress(np.array([0.3]), goal_m)
    whole = rewards(blocked, still, ANGLES, gain, goal_m)
    assert labels_changed(rewards(free, still, ANGLES, gain, goal_m), whole).tolist() == [[False, True, False]]
    assert not labels_changed(rewards(blocked, still, ANGLES, gain, goal_m), whole).any()


def test_a_small_change_of_a_label_does_not_count():
    whole = np.array([2.0, -1.0, -1.0])
    assert labels_changed(whole + np.array([0.9 * CHANGED_REWARD, -1.1 * CHANGED_REWARD, -1.0]), whole).tolist() == [
        False,
        True,
        True,
    ]


def test_a_distance_to_the_side_is_longer_than_its_depth():
    distance = pixel_distance_m(np.full((4, 100), 2.0), math.pi / 2)
    assert distance[0, 0] == pytest.approx(2 * math.sqrt(2), rel=0.01)
    assert distance[0, 50] == pytest.approx(2.0, rel=0.01)
