"""Sheets of scenes."""

import pytest
from matplotlib.image import imread

from zsdist.planning.grid import Grid
from zsdist.reporting.scene_sheet import draw_sheet
from zsdist.sim.scenes import families
from zsdist.sim.scenes.scene import Obstacle, Scene, Start


@pytest.mark.parametrize("count", [1, 40])
def test_any_number_of_scenes_fits_on_one_sheet_of_moderate_size(tmp_path, count):
    rock = Obstacle("rock", 0.0, 0.0, 1.0)
    made = [Scene(f"s{index}", "sand", Start(-8.0, 0.0, 0.0), (8.0, 0.0), (rock,)) for index in range(count)]
    draw_sheet(made, Grid(), tmp_path / "sheet.svg")
    drawing = (tmp_path / "sheet.svg").read_text()
    assert all(f">s{index}<" in drawing for index in range(count)) and drawing.count(">rock<") == 1


def test_a_picture_is_drawn_without_a_diagnosis_too(tmp_path):
    draw_sheet([families.draw("singleton", "test", 0)], Grid(), tmp_path / "sheet.png")
    height, width, _ = imread(tmp_path / "sheet.png").shape
    assert 300 < width < 900 and 300 < height < 900
