import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from zsdist.errors import SceneError
from zsdist.planning.grid import Grid
from zsdist.sim.scenes.families import generate
from zsdist.sim.scenes.kinds import KINDS
from zsdist.sim.scenes.scene import MAX_OBSTACLES, Obstacle, Scene, Start, check, read, read_folder, write

GOOD = """\
version: 1
name: wilderness-0001
ground: sand
start: {x: -8.4, y: -7.5, heading_deg: 45}
goal: {x: 8.1, y: 8.1}
obstacles:
  - {kind: tree, x: 1, y: 2.0}
  - {kind: person, x: 3.0, y: -4.0, path: [[3.0, -4.0], [5.0, -4.0]], speed_mps: 0.8}
  - {kind: sand_pile, x: -2.0, y: 0.5, radius_m: 1.2}
  - {kind: box, x: 0.0, y: 5.0, size_m: [4.0, 0.6, 2.0], heading_deg: 30}
"""
TREE = "{kind: tree, x: 1, y: 2.0}"
PERSON = "path: [[3.0, -4.0], [5.0, -4.0]], speed_mps: 0.8}"

WRONG = {
    "unknown key": ("ground: sand", "ground: sand\ncolour: red", "unknown key 'colour'"),
    "unknown key of an obstacle": (TREE, "{kind: tree, x: 1, y: 2, height_m: 3}", "unknown key 'height_m'"),
    "missing key": ("ground: sand\n", "", "lacks the key 'ground'"),
    "missing coordinate": (TREE, "{kind: tree, x: 1}", "lacks the key 'y'"),
    "key twice": ("ground: sand", "ground: sand\nground: grass", "'ground' appears twice"),
    "version": ("version: 1", "version: 2", "version is 2; allowed is 1"),
    "version of another type": ("version: 1", "version: true", "version is true"),
    "name": ("name: wilderness-0001", "name: ../x", "name is"),
    "ground": ("ground: sand", "ground: snow", "ground is 'snow'; allowed are sand, grass, asphalt"),
    "kind": (TREE, "{kind: cow, x: 1, y: 2}", "kind is 'cow'; allowed are tree"),
    "kind of another type": (TREE, "{kind: [tree], x: 1, y: 2}", "kind is"),
    "no kind": (TREE, "{x: 1, y: 2}", "a mapping with a kind"),
    "NaN": (TREE, "{kind: tree, x: .nan, y: 2}", "x is nan"),
    "infinite": ("y: 8.1", "y: .inf", "goal.y is inf"),
    "huge": (TREE, "{kind: tree, x: 1" + "0" * 400 + ", y: 2}", "allowed is a number"),
    "a bool for a number": (TREE, "{kind: tree, x: true, y: 2}", "x is true; allowed is a number"),
    "a word for a number": (TREE, '{kind: tree, x: "one", y: 2}', "x is 'one'; allowed is a number"),
    "nothing for a number": (TREE, "{kind: tree, x: , y: 2}", "x is ''; allowed is a number"),
    "a time for a number": (TREE, "{kind: tree, x: 1:30, y: 2}", "x is 1:30; allowed is a number"),
    "a hexadecimal number": (TREE, "{kind: tree, x: 0x1, y: 2}", "x is 0x1; allowed is a number"),
    "radius 0": (TREE, "{kind: tree, x: 1, y: 2, radius_m: 0}", "radius_m is 0"),
    "negative radius": (TREE, "{kind: tree, x: 1, y: 2, radius_m: -1}", "radius_m is -1"),
    "size of a round kind": (TREE, "{kind: tree, x: 1, y: 2, size_m: [1, 1, 1]}", "unknown key 'size_m'"),
    "heading of a round kind": (TREE, "{kind: tree, x: 1, y: 2, heading_deg: 3}", "unknown key 'heading_deg'"),
    "box without size": (TREE, "{kind: box, x: 1, y: 2}", "lacks the key 'size_m'"),
    "box with radius": (TREE, "{kind: box, x: 1, y: 2, size_m: [1, 1, 1], radius_m: 1}", "unknown key 'radius_m'"),
    "two sizes": (TREE, "{kind: car, x: 1, y: 2, size_m: [1, 1]}", "a list of 3 numbers"),
    "flat box": (TREE, "{kind: box, x: 1, y: 2, size_m: [1, 0, 1]}", r"size_m\[1\] is 0"),
    "path of a tree": (TREE, "{kind: tree, x: 1, y: 2, path: [[1, 2], [3, 4]], speed_mps: 1}", "unknown key 'path'"),
    "path from elsewhere": (PERSON, "path: [[3.5, -4], [5, -4]], speed_mps: 0.8}", "the person's own centre"),
    "path of one point": (PERSON, "path: [[3.0, -4.0]], speed_mps: 0.8}", "two or more points"),
    "path that stands still": (PERSON, "path: [[3, -4], [3, -4]], speed_mps: 0.8}", "repeats the point before"),
    "path that leaves the arena": (PERSON, "path: [[3, -4], [30, -4]], speed_mps: 0.8}", "outside the arena"),
    "path without speed": (PERSON, "path: [[3.0, -4.0], [5.0, -4.0]]}", "lacks the key 'speed_mps'"),
    "speed without path": (PERSON, "speed_mps: 0.8}", "lacks the key 'path'"),
    "negative speed": (PERSON, PERSON.replace("0.8", "-0.8"), "speed_mps is -0.8"),
    "obstacle on the start": (TREE, "{kind: tree, x: -8, y: -7}", "stands on the start"),
    "wall on the start": (TREE, "{kind: box, x: -8, y: 0, size_m: [0.1, 20, 2]}", "stands on the start"),
    "obstacle over the goal": (TREE, "{kind: tree, x: 8, y: 8}", "covers the goal"),
    "start outside the grid": ("x: -8.4", "x: -10.4", "start .* is outside the grid"),
    "goal outside the grid": ("x: 8.1", "x: 12", "goal .* is outside the grid"),
    "obstacle outside the arena": (TREE, "{kind: tree, x: 13, y: 2}", "outside the arena"),
    "obstacles no list": (GOOD[GOOD.index("obstacles") :], "obstacles: 3", "obstacles is 3"),
    "no mapping": (GOOD, "[1, 2]", "the file is"),
    "empty": (GOOD, "", "the file is None"),
    "no YAML": (GOOD, "a: [1", "not valid YAML"),
    "a constructor": ("ground: sand", "ground: !!python/object:os.system {}", "not valid YAML"),
    "too many": (GOOD, GOOD + f"  - {TREE}\n" * MAX_OBSTACLES, "up to 500"),
    "deeply nested": (GOOD, "[" * 700, "not valid YAML"),
}


@pytest.fixture
def file(tmp_path):
    def make(text, name="scene.yaml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return make


def test_a_scene_file_is_read_as_the_format_says(file):
    scene = read(file(GOOD))
    assert scene.name == "wilderness-0001" and scene.ground == "sand"
    assert scene.start == Start(-8.4, -7.5, 45.0) and scene.goal == (8.1, 8.1)
    tree, person, pile, box = scene.obstacles
    assert (tree.radius_m, pile.radius_m, person.radius_m) == (1.0, 1.2, KINDS["person"].default_radius_m)
    assert person.walks and person.path == ((3.0, -4.0), (5.0, -4.0)) and person.speed_mps == 0.8
    assert box.size_m == (4.0, 0.6, 2.0) and box.height_m == 2.0 and box.heading_deg == 30.0
    assert type(tree.x_m) is float


@pytest.mark.parametrize(("old", "new", "reason"), WRONG.values(), ids=WRONG)
def test_a_wrong_file_is_refused_in_one_line_with_its_name_and_the_reason(file, old, new, reason):
    assert old in GOOD
    path = file(GOOD.replace(old, new))
    with pytest.raises(SceneError, match=reason) as caught:
        read(path)
    message = str(caught.value)
    assert str(path) in message and "\n" not in message and len(message) < 600


@given(st.integers(0, len(GOOD)), st.integers(0, 12), st.text(alphabet="[]{}&*!:?-.,0123456789aex\n'\"#<", max_size=6))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_change_to_a_file_leaves_it_readable_or_refused(file, at, cut, text):
    try:
        scene = read(file(GOOD[:at] + text + GOOD[at + cut :]))
    except SceneError as error:
        assert "\n" not in str(error)
    else:
        check(scene)


def test_a_binary_or_missing_file_is_refused_by_name(tmp_path):
    (tmp_path / "a.yaml").write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(SceneError, match=r"a\.yaml"):
        read(tmp_path / "a.yaml")
    with pytest.raises(SceneError, match=r"b\.yaml: No such file"):
        read(tmp_path / "b.yaml")


@pytest.mark.parametrize("family", ["iid", "ood-layout", "ood-dynamic", "ood-all"])
def test_a_written_scene_reads_back_equal(family, tmp_path):
    for seed in range(5):
        scene = generate(family, seed)
        write(scene, tmp_path / "x.yaml")
        again = read(tmp_path / "x.yaml")
        assert again == scene and again.hash() == scene.hash()


def test_a_scene_without_obstacles_reads_back_equal(tmp_path):
    scene = Scene("empty", "grass", Start(-5.0, 0.0, 0.0), (5.0, 0.0), ())
    write(scene, tmp_path / "x.yaml")
    assert read(tmp_path / "x.yaml") == scene


def test_a_folder_gives_its_scenes_in_the_order_of_file_names(file, tmp_path):
    file(GOOD.replace("0001", "2"), "b.yml")
    file(GOOD.replace("0001", "1"), "a.yaml")
    file("no scene", "readme.txt")
    file("no scene", "._a.yaml")  # as some systems leave beside copied files
    (tmp_path / ".#b.yml").symlink_to("somebody@elsewhere")  # as some editors do
    (tmp_path / "old.yaml").mkdir()
    assert [scene.name for scene in read_folder(tmp_path)] == ["wilderness-1", "wilderness-2"]


def test_a_folder_without_scenes_or_with_a_wrong_one_is_refused(file, tmp_path):
    with pytest.raises(SceneError, match="has no scene file"):
        read_folder(tmp_path)
    with pytest.raises(SceneError, match="does not exist"):
        read_folder(tmp_path / "nowhere")
    file(GOOD, "a.yaml")
    file("version: 1", "b.yaml")
    with pytest.raises(SceneError, match=r"b\.yaml"):
        read_folder(tmp_path)


def test_the_hash_depends_on_the_content_and_not_on_the_name():
    scene = generate("iid", 1)
    assert len(scene.hash()) == 16 and int(scene.hash(), 16) >= 0
    assert replace(scene, name="other").hash() == scene.hash()
    moved = replace(scene.obstacles[0], x_m=scene.obstacles[0].x_m + 0.01)
    assert replace(scene, obstacles=(moved, *scene.obstacles[1:])).hash() != scene.hash()
    assert replace(scene, ground="sand").hash() != scene.hash()


def test_shapes_have_a_row_for_each_obstacle_and_people_move_only_walkers(file):
    scene = read(file(GOOD))
    assert scene.circles().tolist() == [[1.0, 2.0, 1.0], [3.0, -4.0, 0.3], [-2.0, 0.5, 1.2]]
    assert scene.circles(np.array([[4.5, -4.0]]))[1].tolist() == [4.5, -4.0, 0.3]
    assert scene.standing_circles().tolist() == [[1.0, 2.0, 1.0], [-2.0, 0.5, 1.2]]
    assert scene.boxes().tolist() == [[0.0, 5.0, 4.0, 0.6, math.radians(30)]]
    assert [walker.kind for walker in scene.walkers()] == ["person"]


def test_true_occupancy_contains_standing_obstacles_and_no_walkers(file):
    grid = Grid()
    occupied = read(file(GOOD)).occupancy(grid)
    for x_m, y_m, there in (
        (1.0, 2.0, True),
        (0.0, 5.0, True),
        (1.5, 5.9, True),
        (3.0, -4.0, False),
        (-8.4, -7.5, False),
    ):
        fx, fy = grid.fine_index(x_m, y_m)
        assert occupied[fy, fx] == there


def test_the_heading_of_a_start_is_wrapped_to_half_a_turn_either_way():
    assert Start(0.0, 0.0, 270.0).pose.heading_rad == pytest.approx(-math.pi / 2)
    assert Start(0.0, 0.0, 180.0).pose.heading_rad == pytest.approx(math.pi)
    assert Start(0.0, 0.0, -405.0).pose.heading_rad == pytest.approx(-math.pi / 4)


def test_the_grid_of_the_configuration_decides_what_is_outside():
    scene = Scene("s", "grass", Start(-9.0, 0.0, 0.0), (9.0, 0.0), (Obstacle("tree", 0.0, 0.0, 1.0),))
    check(scene)
    with pytest.raises(SceneError, match="outside the grid; allowed is -5 to below 5"):
        check(scene, Grid(cells=16, arena_m=25.0))
