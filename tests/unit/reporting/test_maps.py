import numpy as np
import pytest
from matplotlib.image import imread

from zsdist.planning.grid import Grid
from zsdist.reporting import maps, style
from zsdist.reporting.maps import DrivenPath
from zsdist.sim.scenes import families
from zsdist.sim.scenes.kinds import KINDS
from zsdist.sim.scenes.scene import Obstacle, Scene, Start
from zsdist.types import Outcome

GRID = Grid()
NAMES = list(KINDS)


def scene_of(*obstacles):
    return Scene("made", "grass", Start(-8.0, 0.0, 0.0), (8.0, 0.0), tuple(obstacles))


@pytest.mark.parametrize("count", [1, 4])
def test_paths_are_drawn_over_any_number_of_scenes(tmp_path, count):
    panels = []
    for index in range(count):
        scene = families.draw("ood-all", "test", index)
        points = np.linspace((scene.start.x_m, scene.start.y_m), scene.goal, 10)
        panels.append(
            (scene, [DrivenPath(points, Outcome.SUCCESS, "one", True), DrivenPath(points + 1, Outcome.COLLISION, "b")])
        )
    assert maps.draw_paths(panels, 25.0, tmp_path, "paths") == "paths.png"
    assert imread(tmp_path / "paths.png").std() > 0
    assert "one: success" in (tmp_path / "paths.svg").read_text()


def test_the_legend_of_paths_names_the_obstacles_and_who_walks(tmp_path):
    person = Obstacle("person", 0.0, 3.0, radius_m=0.3, path=((0.0, 3.0), (4.0, 3.0)), speed_mps=1.0)
    scene = scene_of(Obstacle("rock", 0.0, 0.0, radius_m=1.0), person)
    maps.draw_paths([(scene, [])], 25.0, tmp_path, "paths")
    drawing = (tmp_path / "paths.svg").read_text()
    assert all(f">{word}<" in drawing for word in ("start", "target", "rock", "person", "way of a walking person"))
    assert ">tree<" not in drawing


def test_start_and_target_at_the_edge_are_drawn_whole():
    _, (axes,) = style.panels(1, 1, 3, 3)
    maps.draw_ends(axes, scene_of())
    assert axes.lines and not any(line.get_clip_on() for line in axes.lines)


def test_a_paths_colour_shows_its_outcome(tmp_path):
    scene = families.draw("singleton", "test", 0)
    points = np.linspace((-10, 10), (10, 10), 50)
    pictures = []
    for outcome in (Outcome.SUCCESS, Outcome.COLLISION):
        maps.draw_paths([(scene, [DrivenPath(points, outcome, "")])], 25.0, tmp_path, "one")
        pictures.append(imread(tmp_path / "one.png")[..., :3])
    changed = np.abs(pictures[0] - pictures[1]).sum(-1) > 0.5
    assert pictures[0][changed][:, 1].mean() > pictures[0][changed][:, 0].mean()  # green where it succeeded
    assert pictures[1][changed][:, 0].mean() > pictures[1][changed][:, 1].mean()  # red where it collided


def test_a_figure_is_the_same_file_each_time(tmp_path):
    scene = families.draw("singleton", "test", 0)
    for name in ("one", "two"):
        figure, (axes,) = style.panels(1, 1, 3, 3)
        maps.draw_scene(axes, scene, 25.0)
        style.save(figure, tmp_path, name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()


def test_an_obstacle_colours_the_cells_that_it_covers_and_no_other():
    kinds = maps.cells_by_kind(scene_of(Obstacle("box", 0.0, 0.0, size_m=(2.5, 1.25, 1.0))), GRID)
    rows, columns = np.nonzero(kinds == NAMES.index("box"))
    assert (kinds >= 0).sum() == len(rows) == 8
    assert set(rows) == {15, 16} and set(columns) == {14, 15, 16, 17}


def test_an_obstacle_smaller_than_a_cell_still_has_one():
    kinds = maps.cells_by_kind(scene_of(Obstacle("pole", 0.31, 0.31, radius_m=0.05)), GRID)
    assert kinds[16, 16] == NAMES.index("pole") and (kinds >= 0).sum() == 1


def test_a_cell_belongs_to_the_obstacle_that_covers_more_of_it():
    wide, narrow = Obstacle("rock", 0.31, 0.31, radius_m=0.6), Obstacle("bush", 0.31, 1.1, radius_m=0.5)
    for order in ((wide, narrow), (narrow, wide)):
        kinds = maps.cells_by_kind(scene_of(*order), GRID)
        assert kinds[16, 16] == NAMES.index("rock") and (kinds == NAMES.index("bush")).any()


def test_walking_people_are_shown_at_their_start():
    person = Obstacle("person", 0.31, 0.31, radius_m=0.3, path=((0.31, 0.31), (5.0, 0.31)), speed_mps=1.0)
    kinds = maps.cells_by_kind(scene_of(person), GRID)
    assert kinds[16, 16] == NAMES.index("person") and not (kinds[:, 24:] >= 0).any()


def test_grid_maps_name_their_obstacles_and_show_a_rendered_picture(tmp_path):
    scene = scene_of(Obstacle("rock", 0.0, 0.0, radius_m=1.0))
    maps.draw_grid_maps([scene], GRID, tmp_path, "grid", picture=True)
    drawing = (tmp_path / "grid.svg").read_text()
    assert ">rock<" in drawing and ">tree<" not in drawing and "rendered" in drawing
    assert maps.bird_view(scene).std() > 10
