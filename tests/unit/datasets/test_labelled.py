import math

import numpy as np
import pytest

from zsdist.config import CameraConfig
from zsdist.datasets.labelled import boxes_of_any_height, fresh_views, label, labelled_views
from zsdist.errors import SceneError
from zsdist.sim.camera import make_camera
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Pose
from zsdist.vision.rays import RAYS

CAMERA = CameraConfig(size_px=64)


def scene(*obstacles):
    return Scene("test", "grass", Start(-8.0, -8.0, 0.0), (4.0, 3.0), obstacles)


def views(count=12, seed=5, split="vision", **options):
    return list(labelled_views(["street", "iid"], split, count, seed, CAMERA, **options))


@pytest.mark.parametrize("varied", [False, True])
def test_views_have_the_documented_shapes_and_ranges(varied):
    for view in views(varied=varied):
        assert view.image.shape == (64, 64, 3) and view.image.dtype == np.uint8
        assert view.ray_clearance_m.shape == (RAYS,) and view.ray_clearance_m.dtype == np.float32
        assert (view.ray_clearance_m >= 0).all() and (view.ray_clearance_m <= CAMERA.range_m).all()
        assert view.clearance_m.min() == view.ray_clearance_m.min()
        assert view.dynamic.shape == (3,) and view.dynamic.dtype == bool
        assert abs(view.goal_bearing_rad) <= math.pi
        assert view.image.std() > 0


def test_varied_views_are_drawn_by_both_renderers(monkeypatch):
    asked = []

    def camera(config, look):
        asked.append((config.back_end, config.height_m))
        return make_camera(config, look)

    monkeypatch.setattr("zsdist.datasets.sampling.make_camera", camera)
    drawn = views(count=96, seed=8, varied=True)
    assert {back_end for back_end, _ in asked} == {"caster", "pybullet"}
    assert len({height for _, height in asked}) == len(asked) == 12
    assert len(drawn) == 96


def test_the_same_arguments_give_the_same_views_and_another_seed_gives_others():
    for varied in (False, True):
        once, again = views(varied=varied), views(varied=varied)
        assert all((a.image == b.image).all() and a.pose == b.pose for a, b in zip(once, again, strict=True))
    assert views(seed=6)[0].pose != views(seed=5)[0].pose


def test_fresh_views_follow_from_their_seed_and_show_a_scene_several_times():
    once, again, other = (list(fresh_views(["street", "varied"], "vision", 20, seed, CAMERA)) for seed in (1, 1, 2))
    assert all((a.image == b.image).all() and a.pose == b.pose for a, b in zip(once, again, strict=True))
    assert len({view.scene_hash for view in once}) == 2
    assert not {view.image.tobytes() for view in once} & {view.image.tobytes() for view in other}


def test_boxes_get_other_heights_on_the_same_ground_plan():
    box, tree = Obstacle("box", 4.0, 0.0, None, (2.0, 1.0, 2.0), 30.0), Obstacle("tree", 0.0, 6.0, 1.0)
    heights = []
    for seed in range(40):
        changed, same = boxes_of_any_height(scene(box, tree), np.random.default_rng(seed)).obstacles
        assert same == tree and changed.size_m[:2] == box.size_m[:2]
        assert (changed.x_m, changed.y_m, changed.heading_deg) == (4.0, 0.0, 30.0)
        heights.append(changed.size_m[2])
    assert min(heights) < 0.8 and max(heights) > 2.2


def test_splits_share_no_scene():
    assert not {v.scene_hash for v in views(split="vision")} & {v.scene_hash for v in views(split="test")}


def test_an_unknown_split_is_refused():
    with pytest.raises(SceneError, match="holiday"):
        views(split="holiday")


def test_labels_of_a_person_ahead_and_a_tree_at_the_left():
    world = scene(Obstacle("person", 4.0, 0.0, 0.3), Obstacle("tree", 4.0, 3.0, 1.0))
    truth = label(world, Pose(0.0, 0.0, 0.0), CAMERA)
    assert truth["clearance_m"][0] == pytest.approx(3.0 - 0.3, abs=0.02)
    assert truth["clearance_m"][1] == pytest.approx(math.hypot(3.0, 3.0) - 1.0, abs=0.02)
    assert truth["clearance_m"][2] == CAMERA.range_m
    assert truth["dynamic"].tolist() == [True, False, False]
    assert truth["goal_bearing_rad"] == pytest.approx(math.atan2(3.0, 4.0))
    assert truth["goal_distance_m"] == pytest.approx(5.0)


def test_labels_follow_walking_people():
    world = scene(Obstacle("person", 4.0, 0.0, 0.3, path=((4.0, 0.0), (4.0, 2.0)), speed_mps=1.0))
    ahead = label(world, Pose(0.0, 0.0, 0.0), CAMERA)
    aside = label(world, Pose(0.0, 0.0, 0.0), CAMERA, np.array([[4.0, 2.0]]))
    assert ahead["dynamic"].tolist() == [True, False, False]
    assert aside["dynamic"].tolist() == [False, True, False]
