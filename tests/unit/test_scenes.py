"""`python -m zsdist.scenes`: from a family, a scene and a map to files and pictures."""

import json
import re

import numpy as np
import pytest
from matplotlib.image import imread
from PIL import Image

from zsdist import scenes
from zsdist.errors import RunError, SceneError
from zsdist.sim.maps import nav2
from zsdist.sim.scenes import scene
from zsdist.sim.scenes.scene import Obstacle, Scene, Start


def run(*arguments):
    return scenes.main(scenes.make_parser().parse_args([str(argument) for argument in arguments]))


@pytest.fixture
def corridor(tmp_path):
    """A map with one hall of 24 m x 6 m, its outside unknown, as map_saver wrote it with its old threshold."""
    grey = np.full((200, 600), 205, np.uint8)
    grey[40:160, 60:540] = 254
    grey[38:40, 58:542] = grey[160:162, 58:542] = 0
    grey[38:162, 58:60] = grey[38:162, 540:542] = 0
    Image.fromarray(grey).save(tmp_path / "hall.pgm", format="PPM")
    file = tmp_path / "hall.yaml"
    file.write_text(
        "image: hall.pgm\nresolution: 0.05\norigin: [-3.0, -2.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return file


def closed():
    wall = Obstacle("box", 0.0, 0.0, None, (0.4, 25.0, 2.0))
    return Scene("closed", "sand", Start(-8.4375, 0.3125, 0.0), (8.4375, 0.3125), (wall,))


def test_families_become_files_that_are_checked_and_drawn(tmp_path, capsys):
    assert run("generate", "iid", "--count", 2, "--seed", 7, "--out", tmp_path / "own") == 0
    assert [found.name for found in scene.read_folder(tmp_path / "own")] == ["iid-000007", "iid-000008"]
    assert run("draw", tmp_path / "own", "--out", tmp_path / "sheet.png") == 0
    assert imread(tmp_path / "sheet.png").std() > 0.05
    assert run("check", tmp_path / "own", "--json", tmp_path / "found.json") == 0
    rows = json.loads((tmp_path / "found.json").read_text())["scenes"]
    assert all(row["solvable"] and row["shortest_m"] > 10 and row["narrow"] for row in rows)
    assert "2 scenes: 2 can be driven, 0 cannot" in capsys.readouterr().out


def test_scenes_without_a_way_and_invalid_ones_are_all_named_and_drawn(tmp_path, capsys):
    scene.write(closed(), tmp_path / "a.yaml")
    (tmp_path / "b.yaml").write_text("version: 1\n")
    assert run("check", tmp_path, "--out", tmp_path / "why.svg") == scenes.FAULTY
    said = capsys.readouterr().out
    assert re.search(r"^no way +closed: obstacles close it off", said, re.MULTILINE)
    assert re.search(r"^invalid +scene file .*b\.yaml: the file lacks", said, re.MULTILINE)
    assert "2 scenes: 0 can be driven, 2 cannot" in said
    assert "closed: no way" in (tmp_path / "why.svg").read_text()


def test_a_check_that_finds_faults_names_the_command_that_draws_them(tmp_path, capsys):
    scene.write(closed(), tmp_path / "a.yaml")
    assert run("check", tmp_path / "a.yaml") == scenes.FAULTY
    assert f"zsdist.scenes check {tmp_path / 'a.yaml'} --out check.png" in capsys.readouterr().out


def test_a_map_becomes_scenes_and_what_its_reader_may_not_expect_is_said(tmp_path, corridor, capsys):
    assert run("from-map", corridor, "--out", tmp_path / "own", "--count", 2) == 0
    said = capsys.readouterr().out
    assert "have the grey 205, which map_saver writes for unknown cells" in said and "--unknown occupied" in said
    first, second = scene.read_folder(tmp_path / "own")
    assert first.obstacles == second.obstacles and first.start != second.start
    text = (tmp_path / "own" / f"{first.name}.yaml").read_text()
    assert re.match(r"# from 'hall\.yaml'; \(0, 0\) is \(.+, .+\) of the map's frame", text)
    assert run("from-map", corridor, "--out", tmp_path / "filled", "--unknown", "occupied") == 0
    assert "205" not in capsys.readouterr().out
    (filled,) = scene.read_folder(tmp_path / "filled")
    area = [sum(o.size_m[0] * o.size_m[1] for o in one.obstacles if o.size_m) for one in (first, filled)]
    assert area[1] > 5 * area[0]


def test_a_scene_goes_to_a_map_and_comes_back_by_the_command_that_is_printed(tmp_path, capsys):
    run("generate", "ood-layout", "--seed", 3, "--out", tmp_path / "own")
    capsys.readouterr()
    run("to-map", tmp_path / "own", "--out", tmp_path / "maps", "--resolution-m", "0.05", "--format", "pgm")
    (before,) = scene.read_folder(tmp_path / "own")
    found = nav2.read(tmp_path / "maps" / f"{before.name}.yaml")
    assert found.cells.shape == (500, 500) and found.origin == (-12.5, -12.5, 0.0)
    words = re.search(r"zsdist\.scenes (from-map .+)", capsys.readouterr().out)[1].split()
    run(*(str(tmp_path / "back") if word == "DIR" else word for word in words))
    (after,) = scene.read_folder(tmp_path / "back")
    assert (after.start, after.goal) == (before.start, before.goal) and after.obstacles


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("generate", "nothing", "--out", "o"), "allowed are singleton"),
        (("check", "none.yaml"), "does not exist"),
        (("draw", "none", "--out", "a.gif"), r"allowed is a picture named \*.png"),
        (("from-map", "none.yaml", "--out", "o"), "none.yaml"),
        (("from-map", "none.yaml", "--out", "o", "--goal", "1", "2"), "--start and --goal go together"),
        (("from-map", "none.yaml", "--out", "o", "--lethal", "101"), "allowed is 1 to 100"),
        (("to-map", "none.yaml", "--out", "o", "--resolution-m", "0.03"), "such as 0.01"),
    ],
)
def test_what_cannot_be_done_is_refused_before_a_folder_is_made(tmp_path, monkeypatch, arguments, why):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((SceneError, RunError), match=why):
        run(*arguments)
    assert not list(tmp_path.iterdir())


def test_a_map_given_as_a_scene_names_the_command_that_reads_it(corridor):
    with pytest.raises(SceneError, match=r"zsdist\.scenes from-map"):
        scene.read(corridor)
    scene.write(closed(), corridor)
    with pytest.raises(SceneError, match="scene already"):
        nav2.read(corridor)
