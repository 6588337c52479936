import numpy as np
import pytest

from zsdist.config import CameraConfig
from zsdist.datasets.labelled import label
from zsdist.datasets.masked import masked_view, masked_views, remove_obstacle
from zsdist.errors import SceneError
from zsdist.sim.camera.caster import INSTANCE_GROUND, INSTANCE_SKY, INSTANCE_WALL, CasterCamera
from zsdist.sim.scenes.kinds import KINDS, SEGMENT_GROUND, SEGMENT_SKY, SEGMENT_WALL
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Pose

CAMERA = CameraConfig(size_px=64)
HERE = Pose(0.0, 0.0, 0.0)


def scene(*obstacles):
    return Scene("test", "grass", Start(-8.0, -8.0, 0.0), (4.0, 3.0), obstacles)


def person(x_m, y_m, path=()):
    return Obstacle("person", x_m, y_m, 0.3, path=path, speed_mps=1.0 if path else 0.0)


def test_instances_agree_with_segments_and_the_picture_is_the_same():
    world, eye = scene(Obstacle("tree", 5.0, 1.5, 1.0), person(4.0, -1.0), Obstacle("rock", 6.0, -3.0, 0.8)), None
    eye = CasterCamera(CAMERA)
    image, depth, segments = eye.render_labelled(world, HERE)
    again, depth_again, instances = eye.render_instances(world, HERE)
    assert (image == again).all() and (depth == depth_again).all()
    numbers = {INSTANCE_SKY: SEGMENT_SKY, INSTANCE_GROUND: SEGMENT_GROUND, INSTANCE_WALL: SEGMENT_WALL}
    numbers |= {index: KINDS[obstacle.kind].segment_id for index, obstacle in enumerate(world.obstacles)}
    assert set(np.unique(instances)) == set(numbers)
    assert (np.vectorize(numbers.get)(instances) == segments).all()


def test_the_truth_of_a_mask_is_that_of_the_scene_without_its_object():
    near, behind = person(3.0, 0.0), Obstacle("rock", 5.0, 0.0, 0.8)
    view = masked_view(CasterCamera(CAMERA), scene(behind, near), HERE)
    objects = [mask for mask in view.masks if not mask.background]
    assert len(objects) == 2
    for gone in (near, behind):
        left = label(scene(*({near, behind} - {gone})), HERE, CAMERA)
        (match,) = [mask for mask in objects if (mask.ray_distance_m == left["ray_clearance_m"]).all()]
        assert (match.ray_dynamic == left["ray_dynamic"]).all()
        assert match.hidden.any()
    assert view.ray_dynamic.any() and not objects[0].ray_dynamic.all()
    assert view.scene_hash == scene(behind, near).hash()


def test_background_masks_leave_the_truth_unchanged():
    view = masked_view(CasterCamera(CAMERA), scene(person(3.0, 0.0)), HERE)
    background = [mask for mask in view.masks if mask.background]
    assert len(background) >= 4
    assert all((mask.ray_distance_m == view.ray_distance_m).all() for mask in background)


def test_removing_a_walker_leaves_the_positions_of_the_others():
    first, second = person(4.0, 0.0, ((4.0, 0.0), (4.0, 2.0))), person(3.0, -2.0, ((3.0, -2.0), (3.0, -1.0)))
    people = np.array([[4.0, 1.0], [3.0, -1.5]])
    rest, places = remove_obstacle(scene(Obstacle("rock", 8.0, 0.0, 0.5), first, second), 1, people)
    assert rest.walkers() == (second,)
    assert places.tolist() == [[3.0, -1.5]]
    assert remove_obstacle(scene(first), 0, None)[1] is None


@pytest.mark.parametrize("varied", [False, True])
def test_masked_views_repeat_with_their_arguments_and_have_at_most_sixteen_masks(varied):
    def views():
        return list(masked_views(["street", "varied"], "vision", 10, 3, CAMERA, varied))

    first, again = views(), views()
    assert len(first) == 10
    for one, other in zip(first, again, strict=True):
        assert (one.image == other.image).all() and len(one.masks) == len(other.masks) <= 16
    assert {mask.background for view in first for mask in view.masks} == {True, False}
    assert len(list(masked_views(["street"], "vision", 0, 3, CAMERA))) == 0


def test_a_camera_without_instances_is_refused():
    with pytest.raises(SceneError, match="pybullet"):
        next(masked_views(["street"], "vision", 1, 0, CAMERA.model_copy(update={"back_end": "pybullet"})))
