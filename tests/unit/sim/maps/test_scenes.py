"""Scenes from maps and maps from scenes."""

import math

import numpy as np
import pytest

from zsdist.errors import SceneError
from zsdist.planning.grid import Grid
from zsdist.sim.maps.nav2 import OccupancyMap
from zsdist.sim.maps.scenes import (
    ObstacleRules,
    centres,
    cut,
    ends,
    known_free,
    occupied_cells,
    scene_between,
    scenes_of,
)
from zsdist.sim.physics.collision import clearance_m
from zsdist.sim.scenes import families
from zsdist.sim.scenes.scene import Scene, Start
from zsdist.sim.scenes.solvability import solve
from zsdist.types import Pose

GRID = Grid()


def map_of(cells, resolution_m=0.1, origin=(0.0, 0.0, 0.0)):
    cells = np.asarray(cells, np.int8)
    return OccupancyMap("made", cells, resolution_m, origin, np.zeros(cells.shape, bool))


def hall(wide_m, high_m, resolution_m=0.1):
    """A free hall with walls of 0.2 m around it."""
    cells = np.zeros((round(high_m / resolution_m), round(wide_m / resolution_m)), np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = 100
    return map_of(cells, resolution_m)


@pytest.mark.parametrize("family", ["ood-layout", "ood-clusters", "street"])
def test_a_scene_comes_back_from_its_map(family):
    scene, cell_m = families.draw(family, "test", 3), 0.02
    before = occupied_cells(scene, cell_m)
    found = map_of(np.where(before, 100, 0), cell_m, (-12.5, -12.5, 0.0))
    again, window = scene_between(found, ObstacleRules(), scene.start, scene.goal, "grass")
    assert window.centre == (0.0, 0.0) and window.tolerance_m == 0.05
    assert (again.start, again.goal) == (scene.start, scene.goal)
    after = occupied_cells(again, cell_m)
    assert (before ^ after).sum() <= 0.02 * before.sum()


@pytest.mark.parametrize(
    ("wide_m", "high_m", "xs", "ys"),
    [
        (12, 8, [6.0], [4.0]),
        (25, 25, [12.5], [12.5]),
        (30, 20, [10.0, 20.0], [10.0]),
        (55, 41, [10.0, 27.5, 45.0], [10.0, 20.5, 31.0]),
    ],
)
def test_the_planning_grids_of_the_windows_cover_the_known_map(wide_m, high_m, xs, ys):
    found = centres(hall(wide_m, high_m))
    assert sorted({x for x, _ in found}) == pytest.approx(xs) and sorted({y for _, y in found}) == pytest.approx(ys)
    assert len(found) == len(xs) * len(ys)


def test_unknown_margins_do_not_count_and_a_map_without_known_cells_is_refused():
    cells = np.full((400, 400), -1)
    cells[100:150, 200:260] = 0
    assert centres(map_of(cells)) == [(23.0, 12.5)]
    with pytest.raises(SceneError, match="no known cell"):
        centres(map_of(np.full((4, 4), -1)))


def test_a_large_map_is_cut_into_scenes_that_can_be_driven():
    found = hall(45, 26)
    found.cells[:200, 225:229] = 100
    made, unusable = scenes_of(found, ObstacleRules(), 8, np.random.default_rng(0), "asphalt")
    assert [scene.name for scene, _ in made] == [f"made-{index:03d}" for index in range(8)] and not unusable
    assert len({window.centre for _, window in made}) == 6
    for scene, window in made:
        assert solve(scene) is not None
        apart = math.hypot(scene.start.x_m - scene.goal[0], scene.start.y_m - scene.goal[1])
        assert apart >= 10.0
        for x_m, y_m in ((scene.start.x_m, scene.start.y_m), scene.goal):
            column, row = (int((at + middle) / 0.1) for at, middle in zip((x_m, y_m), window.centre, strict=True))
            around = found.cells[max(row - 14, 0) : row + 15, max(column - 14, 0) : column + 15]
            assert around.max() == 0  # 1.5 m from every wall, less a cell


def test_the_same_seed_gives_the_same_scenes_and_more_of_them_begin_alike():
    few, many = (scenes_of(hall(24, 24), ObstacleRules(), n, np.random.default_rng(5), "sand")[0] for n in (1, 3))
    assert few[0][0].start == many[0][0].start and len({scene.start for scene, _ in many}) > 1


def test_the_yaw_of_a_map_turns_its_obstacles_into_the_axes_of_its_frame():
    cells = np.zeros((200, 200), np.int8)
    cells[100:104, 20:180] = 100  # along the picture's rows
    plain, turned = map_of(cells), map_of(cells, origin=(0.0, 0.0, math.pi / 6))
    (one,), (other,) = (cut(each, centres(each)[0], ObstacleRules()).obstacles for each in (plain, turned))
    assert (other.heading_deg - one.heading_deg) % 180 == pytest.approx(30.0, abs=0.5)
    assert other.size_m == pytest.approx(one.size_m, abs=0.05)
    x_m, y_m = turned.to_world(10.0, 10.2)
    middle = centres(turned)[0]
    assert (other.x_m, other.y_m) == pytest.approx((x_m - middle[0], y_m - middle[1]), abs=0.05)


def test_unknown_cells_and_what_lies_beyond_the_map_are_free_or_obstacles_as_one_says():
    cells = np.zeros((100, 100), np.int8)
    cells[40:60, 40:60] = -1
    found = map_of(cells)
    middle = centres(found)[0]
    assert cut(found, middle, ObstacleRules()).obstacles == ()
    filled = Scene(
        "a", "sand", Start(0, 0, 0), (0, 0), cut(found, middle, ObstacleRules(unknown_occupied=True)).obstacles
    )
    for x_m, y_m, expected in ((0.0, 0.0, True), (-3.0, 0.0, False), (-8.0, 0.0, True), (8.0, 11.0, True)):
        gap_m = clearance_m(Pose(x_m, y_m, 0.0), filled.circles(), filled.boxes(), 0.0, 0.0)
        assert (gap_m == 0.0) is expected, (x_m, y_m)
    assert not known_free(found, middle)[15:17, 15:17].any() and known_free(found, middle).any()


def test_cells_below_the_lethal_occupancy_are_free():
    cells = np.zeros((100, 100), np.int8)
    cells[40:60, 40:60] = 70
    found = map_of(cells)
    sizes = [len(cut(found, centres(found)[0], ObstacleRules(lethal=lethal)).obstacles) for lethal in (100, 71, 70, 1)]
    assert sizes == [0, 0, 1, 1]


def test_no_start_and_goal_are_made_up_where_there_is_no_way():
    assert next(ends((), np.zeros((32, 32), bool), np.random.default_rng(0)), None) is None
    found = hall(6, 6)
    with pytest.raises(SceneError, match="no start and goal"):
        scenes_of(found, ObstacleRules(), None, np.random.default_rng(0), "asphalt")


def test_a_start_in_a_wall_or_too_far_from_the_goal_is_refused():
    with pytest.raises(SceneError, match="stands on the start"):
        scene_between(hall(20, 20), ObstacleRules(), Start(0.5, 10.0, 0.0), (15.0, 10.0), "asphalt")
    with pytest.raises(SceneError, match="outside the grid"):
        scene_between(hall(60, 20), ObstacleRules(), Start(5.0, 10.0, 0.0), (55.0, 10.0), "asphalt")
