import itertools
import math
import subprocess
import sys

import numpy as np
import pytest

from zsdist.errors import SceneError
from zsdist.planning.footprint import successor
from zsdist.sim.physics.collision import NO_CIRCLES, clearance_m, touching
from zsdist.sim.scenes import families
from zsdist.sim.scenes.families import FAMILIES, SINGLETON_SCENES, generate, generate_counted
from zsdist.sim.scenes.families_canvas import Redraw, turned
from zsdist.sim.scenes.scene import DEFAULT_GRID, Obstacle, Start, check
from zsdist.sim.scenes.solvability import shortest_m, solve
from zsdist.types import Pose

SEEDS = range(5)
EVERY = [(family, seed) for family in FAMILIES for seed in SEEDS]


def toward_goal(scene):
    return math.degrees(math.atan2(scene.goal[1] - scene.start.y_m, scene.goal[0] - scene.start.x_m))


@pytest.mark.parametrize("family", FAMILIES)
def test_every_scene_can_be_driven_to_the_goal_without_touching_standing_obstacles(family):
    for seed in SEEDS:
        scene = generate(family, seed)
        check(scene)
        way = solve(scene)
        assert successor(way.states[0], way.actions[0]) == way.states[1]
        circles, boxes = scene.standing_circles(), scene.boxes()
        for one, other in itertools.pairwise(DEFAULT_GRID.pose(state) for state in way.states):
            turn = math.remainder(other.heading_rad - one.heading_rad, math.tau)
            on_the_way = [Pose(one.x_m, one.y_m, one.heading_rad + turn * t) for t in (0.0, 0.25, 0.5, 0.75, 1.0)]
            on_the_way.append(Pose((one.x_m + other.x_m) / 2, (one.y_m + other.y_m) / 2, other.heading_rad))
            assert not any(touching(pose, circles, boxes, arena_m=25.0) for pose in on_the_way)


@pytest.mark.parametrize("family", FAMILIES)
def test_start_and_goal_are_on_the_lattice_ten_metres_apart_and_clear(family):
    for seed in SEEDS:
        scene = generate(family, seed)
        pose = scene.start.pose
        assert DEFAULT_GRID.pose(DEFAULT_GRID.lattice_state(pose)) == pytest.approx(pose)
        assert DEFAULT_GRID.centre(*DEFAULT_GRID.cell_at(*scene.goal)) == scene.goal
        assert math.dist((pose.x_m, pose.y_m), scene.goal) >= 10.0
        for x_m, y_m in ((pose.x_m, pose.y_m), scene.goal):
            assert clearance_m(Pose(x_m, y_m, 0.0), scene.circles(), scene.boxes(), 0.0, 0.0) >= 1.5 - 1e-9


def test_scenes_are_named_by_family_and_seed_and_differ():
    assert generate("iid", 42).name == "iid-000042"
    assert len({generate(family, seed).hash() for family, seed in EVERY}) == len(EVERY)


def test_the_same_family_and_seed_give_the_same_scene_in_another_process():
    wanted = [generate(family, 5).hash() for family in FAMILIES]
    code = "from zsdist.sim.scenes.families import *; print(*[generate(f, 5).hash() for f in FAMILIES])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert out.stdout.split() == wanted


def test_singleton_has_ten_scenes_and_refuses_others():
    assert SINGLETON_SCENES == 10
    assert len({generate("singleton", seed).hash() for seed in range(10)}) == 10
    for seed in (10, -1):
        with pytest.raises(SceneError, match="allowed is 0 to 9"):
            generate("singleton", seed)


def test_an_unknown_family_is_refused_with_a_list_of_the_known_ones():
    with pytest.raises(SceneError, match="'ood'; allowed are singleton, iid"):
        generate("ood", 0)


def test_a_family_without_a_solvable_draw_ends_in_an_error(monkeypatch):
    def hopeless(rng, name):
        raise Redraw

    monkeypatch.setitem(families.FAMILIES, "iid", hopeless)
    with pytest.raises(SceneError, match="iid-000003: none of 200 draws"):
        generate("iid", 3)


def test_an_unsolvable_draw_is_drawn_again(monkeypatch):
    first = generate("iid", 0)
    real = families.solve
    seen = []
    monkeypatch.setattr(families, "solve", lambda scene: seen.append(scene) or (real(scene) if len(seen) > 1 else None))
    again, tries = generate_counted("iid", 0)
    assert tries >= 2 and again != first


def test_iid_leads_from_west_to_east_among_12_to_20_and_start_goal_leads_elsewhere():
    for seed in SEEDS:
        scene = generate("iid", seed)
        assert scene.start.x_m < -7 and scene.goal[0] > 7
        assert abs(toward_goal(scene)) < families.OFF_EAST_DEG < abs(toward_goal(generate("ood-start-goal", seed)))
        assert 12 <= len(scene.obstacles) <= 20
    kinds = [obstacle.kind for seed in range(15) for obstacle in generate("iid", seed).obstacles]
    assert kinds.count("tree") > len(kinds) / 2
    assert all(o.radius_m == 1.0 for o in generate("iid", 0).obstacles if o.kind == "tree")


def test_passages_between_walls_are_three_metres_wide_or_closed():
    walls_seen = 0
    for seed in range(40):
        boxes = generate("ood-layout", seed).boxes()
        walls_seen += len(boxes)
        for one, other in itertools.combinations(boxes, 2):
            gap = clearance_m(Pose(one[0], one[1], one[4]), NO_CIRCLES, other[None], one[2], one[3])
            assert gap < 0.03 or gap >= 3.0 - 0.003
    assert walls_seen >= 80


def test_paths_in_layout_scenes_are_longer_than_in_iid_ones():
    def detour(family):
        scenes = [generate(family, seed) for seed in range(20)]
        return np.mean([shortest_m(s) / math.dist((s.start.x_m, s.start.y_m), s.goal) for s in scenes])

    assert detour("ood-layout") > detour("iid") + 0.05


def test_clusters_are_closer_and_density_has_more_and_smaller_obstacles_than_iid():
    def nearest_gap(scene):
        circles = scene.circles()
        gaps = np.hypot(*(circles[:, None, :2] - circles[None, :, :2]).T) - circles[:, 2] - circles[:, 2][:, None]
        return np.median((gaps + 100 * np.eye(len(gaps))).min(axis=0))

    scenes = {family: [generate(family, seed) for seed in SEEDS] for family in ("iid", "ood-clusters", "ood-density")}
    assert np.mean([nearest_gap(s) for s in scenes["ood-clusters"]]) < 0.6 * np.mean(
        [nearest_gap(s) for s in scenes["iid"]]
    )
    assert min(len(s.obstacles) for s in scenes["ood-density"]) > max(len(s.obstacles) for s in scenes["iid"])
    assert max(s.circles()[:, 2].max() for s in scenes["ood-density"]) < 1.0


def test_people_walk_only_in_dynamic_scenes_and_clear_of_start_goal_and_standing_obstacles():
    for family, seed in EVERY:
        scene = generate(family, seed)
        assert bool(scene.walkers()) == (family in ("ood-dynamic", "ood-all"))
        for person in scene.walkers():
            assert 0 < person.speed_mps <= 1.2
            for (x0, y0), (x1, y1) in itertools.pairwise(person.path):
                for t in np.linspace(0, 1, 12):
                    at = Pose(x0 + (x1 - x0) * t, y0 + (y1 - y0) * t, 0.0)
                    room = clearance_m(at, scene.standing_circles(), scene.boxes(), 0.0, 0.0) - person.radius_m
                    assert room > 0.05
                    ends = ((scene.start.x_m, scene.start.y_m), scene.goal)
                    assert min(math.dist(at[:2], end) for end in ends) - person.radius_m > 1.45


def test_a_scene_turned_by_a_quarter_keeps_its_shortest_path():
    scene = generate("ood-dynamic", 2)
    once = turned(scene, 1)
    assert shortest_m(once) == pytest.approx(shortest_m(scene), abs=1e-6)
    assert once.obstacles[0].x_m == -scene.obstacles[0].y_m
    assert once.start.heading_deg == (scene.start.heading_deg + 90) % 360
    back = turned(once, 3)
    assert back.circles() == pytest.approx(scene.circles()) and back.goal == scene.goal


def test_a_walled_off_goal_has_no_path_and_a_walker_in_a_gap_does_not_close_it():
    scene = generate("iid", 0)
    wall = Obstacle("box", 0.0, 0.0, None, (0.5, 25.0, 2.0))
    closed = type(scene)("closed", "grass", Start(-8.4375, 0.3125, 0.0), (8.4375, 0.3125), (wall,))
    assert solve(closed) is None and shortest_m(closed) == math.inf
    halves = tuple(Obstacle("box", 0.0, side * 7.1, None, (0.5, 10.8, 2.0)) for side in (-1, 1))
    person = Obstacle("person", 0.0, 0.3, 0.3, path=((0.0, 0.3), (2.0, 0.3)), speed_mps=0.5)
    open_ = type(scene)("open", "grass", closed.start, closed.goal, (*halves, person))
    assert solve(open_) is not None
