import math

import numpy as np
import pytest

from zsdist.vision.rays import RAYS, ray_angles_rad
from zsdist.vision.words.table3 import background_share, directions_of, object_share, only_direction, table3

ANGLES = ray_angles_rad(RAYS, math.pi / 2)
TREE, ROCK = 3, 6
AHEAD, LEFT, RIGHT = 0, 1, 2
AXES = np.eye(3)


def rays(*things):
    """Return the rays of one picture with obstacles of (first ray, end, kind, distance)."""
    kind, distance = np.zeros((1, RAYS), np.uint8), np.full((1, RAYS), 5.0)
    for first, end, segment, metres in things:
        kind[0, first:end], distance[0, first:end] = segment, metres
    return kind, distance, ANGLES


def looks(*along):
    """Return embeddings I_0 to I_3 of one picture with the given cosines to the axis of the word."""
    share = np.array(along)[:, None]
    return (share * AXES[0] + np.sqrt(1 - share**2) * AXES[1])[None]


def test_an_object_is_in_the_direction_whose_rays_meet_it():
    for where, first in ((LEFT, 2), (AHEAD, 15), (RIGHT, 28)):
        assert only_direction(*directions_of(TREE, *rays((first, first + 3, TREE, 2.0)))).tolist() == [where]


def test_an_object_behind_a_nearer_one_is_present_but_not_nearest():
    nearest, any_of_it = directions_of(TREE, *rays((0, 2, TREE, 3.0), (4, 6, ROCK, 1.0)))
    assert nearest.tolist() == [[False] * 3] and any_of_it.tolist() == [[False, True, False]]
    assert only_direction(nearest, any_of_it).tolist() == [-1]


def test_a_kind_in_two_directions_has_no_single_direction():
    found = directions_of(TREE, *rays((0, 2, TREE, 3.0), (28, 30, TREE, 1.0)))
    assert only_direction(*found).tolist() == [-1]


def test_an_object_counts_if_the_right_embedding_is_nearest():
    embeddings = np.concatenate([looks(0.9, 0.6, 0.2, 0.1), looks(0.1, 0.3, 0.4, 0.2), looks(0.1, 0.9, 0.1, 0.1)])
    assert object_share(embeddings, AXES[0], np.array([AHEAD, LEFT, RIGHT])) == pytest.approx(2 / 3)
    assert object_share(embeddings, AXES[0], np.array([AHEAD, -1, -1])) == 1.0
    assert math.isnan(object_share(embeddings, AXES[0], np.array([-1, -1, -1])))


def test_a_background_counts_if_it_is_less_similar_in_every_direction():
    embeddings = np.concatenate([looks(0.5, 0.4, 0.3, 0.2), looks(0.5, 0.4, 0.6, 0.2)])
    assert background_share(embeddings, AXES[0], np.array([True, True])) == 0.5
    assert background_share(embeddings, AXES[0], np.array([True, False])) == 1.0
    assert math.isnan(background_share(embeddings, AXES[0], np.array([False, False])))


def test_rows_are_means_over_the_pictures_that_belong_to_them():
    embeddings = np.concatenate([looks(0.2, 0.6, 0.1, 0.1), looks(0.4, 0.8, 0.1, 0.1), looks(0.9, 0.1, 0.8, 0.3)])
    words = {"tree": AXES[0], "grass": 2 * AXES[0], "sand": AXES[2]}
    rows = table3(
        embeddings,
        words,
        {"tree": np.array([AHEAD, AHEAD, LEFT])},
        {"grass": np.array([False, False, True]), "sand": np.zeros(3, bool)},
    )
    assert rows["tree"] == pytest.approx({"I_0": 0.3, "I_1": 0.7, "I_2": 0.1, "I_3": 0.1, "images": 2})
    assert rows["grass"] == pytest.approx({"I_0": 0.9, "I_1": 0.1, "I_2": 0.8, "I_3": 0.3, "images": 1})
    assert set(rows) == {"tree", "grass"}
