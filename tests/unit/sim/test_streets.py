import dataclasses
import math

import numpy as np
import pytest

from zsdist.config import CameraConfig
from zsdist.sim.camera import make_camera
from zsdist.sim.camera.appearance import Pattern, of_scene, varied
from zsdist.sim.camera.optics import mount
from zsdist.sim.camera.primitives import primitives_of
from zsdist.sim.scenes.families import FAMILIES, generate
from zsdist.sim.scenes.families_canvas import turned
from zsdist.sim.scenes.families_layout import ROAD_HALF_M, road_of
from zsdist.sim.scenes.kinds import SEGMENT_GROUND
from zsdist.sim.scenes.manifest import split_seed
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Pose

SIZE = 96
STREETS = [generate("street", split_seed("vision", index)) for index in range(12)]


@pytest.mark.parametrize("street", STREETS)
def test_the_road_of_a_street_has_its_poles_on_the_pavements_and_its_cars_before_the_kerbs(street):
    road = road_of(street)
    assert ROAD_HALF_M[0] - 0.01 <= road.half_m <= ROAD_HALF_M[1] + 0.01
    for kind, behind in (("pole", True), ("car", False), ("box", True)):
        for obstacle in (o for o in street.obstacles if o.kind == kind):
            across = (obstacle.y_m if road.along_x else obstacle.x_m) - road.middle_m
            assert (abs(across) > road.half_m) == behind


def test_the_road_turns_with_its_street():
    road, quarter = road_of(STREETS[0]), road_of(turned(STREETS[0], 1))
    assert quarter.along_x != road.along_x and quarter.half_m == pytest.approx(road.half_m)
    assert abs(quarter.middle_m) == pytest.approx(abs(road.middle_m))


@pytest.mark.parametrize("family", [family for family in FAMILIES if family != "street"])
def test_no_other_family_has_a_road(family):
    scenes = [generate(family, index if family == "singleton" else split_seed("vision", index)) for index in range(8)]
    asphalt = [dataclasses.replace(scene, ground="asphalt") for scene in scenes]
    assert all(road_of(scene) is None for scene in (*scenes, *asphalt))
    looks = [of_scene(scene, primitives_of(scene)) for scene in scenes]
    assert all(look.ground[6] != Pattern.KERBS for look in looks)


def test_cars_and_poles_that_stand_anywhere_make_no_road():
    poles = [Obstacle("pole", x_m, y_m, 0.15) for x_m in (-3.0, 3.0) for y_m in (-4.7, 4.7)]
    car = Obstacle("car", 0.0, 3.3, None, (4.2, 1.8, 1.5))
    start = Start(-8.0, 0.0, 0.0)
    assert road_of(Scene("street", "asphalt", start, (8.0, 0.0), (*poles, car))) is not None
    off_line = dataclasses.replace(poles[3], y_m=5.7)
    in_the_lane = dataclasses.replace(car, y_m=2.0)
    for obstacles in (poles, [car], [*poles[:3], off_line, car], [*poles, in_the_lane]):
        assert road_of(Scene("other", "asphalt", start, (8.0, 0.0), tuple(obstacles))) is None
    assert road_of(Scene("meadow", "grass", start, (8.0, 0.0), (*poles, car))) is None


@pytest.mark.parametrize("street", STREETS[:4])
def test_pavements_and_kerbs_are_drawn_beyond_the_road_and_nowhere_else(street):
    road, config = road_of(street), CameraConfig(size_px=SIZE, height_m=5.0)  # over the cars

    def bare(scene, primitives):
        look = of_scene(scene, primitives)
        look.ground[6] = Pattern.NONE
        return look

    pose = Pose(-9.0, road.middle_m, 0.3) if road.along_x else Pose(road.middle_m, -9.0, math.pi / 2 + 0.3)
    image, depth, segments = make_camera(config).render_labelled(street, pose)
    changed = (image != make_camera(config, bare).render(street, pose)).any(-1)
    origin, axes = mount(pose, config.forward_m, config.height_m)
    slope = 1 - 2 * (np.arange(SIZE) + 0.5) / SIZE
    rays = axes[0] + slope[:, None] * axes[1] + slope[:, None, None] * axes[2]
    ground = (segments == SEGMENT_GROUND) & (depth < 20.0)
    across = (origin + depth[..., None] * rays)[ground][:, 1 if road.along_x else 0] - road.middle_m
    beyond = np.abs(across) - road.half_m
    assert (beyond > 0.02).sum() > 20
    assert changed[ground][beyond > 0.02].mean() > 0.95
    assert not changed[ground][(beyond < -0.27) & (np.abs(across) > 0.08)].any()
    assert not changed[segments != SEGMENT_GROUND].any()


def test_varied_appearances_of_a_street_mostly_show_its_road_and_any_scene_may_have_one():
    def patterns(scene):
        primitives = primitives_of(scene)
        return [varied(scene, primitives, np.random.default_rng(seed)).ground for seed in range(60)]

    street, meadow = patterns(STREETS[0]), patterns(generate("varied", split_seed("vision", 1)))
    road = road_of(STREETS[0])
    true = [g for g in street if g[6] == Pattern.KERBS and g[18] == pytest.approx(road.half_m)]
    assert 0.25 < len(true) / 60 < 0.65
    elsewhere = [g for g in meadow if g[6] == Pattern.KERBS]
    assert 0 < len(elsewhere) < 20
    assert all(ROAD_HALF_M[0] <= g[18] <= ROAD_HALF_M[1] for g in elsewhere)


@pytest.mark.parametrize(
    ("family", "index", "mean", "sums"),
    [
        ("iid", 1, 115.928, (287.5164, 6.4004, 5.1337, 132.9064)),
        ("ood-density", 0, 132.192, (635.8578, 12.7372, 4.3043, 111.7281)),
        ("ood-all", 0, 192.201, (342.6355, 10.3437, 5.1622, 132.3292)),
        ("varied", 0, 118.665, (314.6755, 8.0308, 4.8905, 62.9253)),
    ],
)
def test_scenes_other_than_streets_look_as_they_did_before_streets_had_kerbs(family, index, mean, sums):
    scene = generate(family, split_seed("vision", index))
    look = of_scene(scene, primitives_of(scene))
    found = [part.sum() for part in (look.materials, look.ground, look.sky, look.light)]
    assert found == pytest.approx(sums, abs=1e-4)
    image = make_camera(CameraConfig(size_px=64)).render(scene, scene.start.pose)
    assert image.mean() == pytest.approx(mean, abs=0.01)  # bit-identical on one machine; others may round
