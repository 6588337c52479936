import numpy as np
import pytest
from matplotlib.image import imread

from zsdist.evaluation import figures
from zsdist.evaluation.figures import Track
from zsdist.sim import families
from zsdist.types import Outcome


def test_running_mean_grows_into_its_window():
    np.testing.assert_allclose(figures.running_mean(np.array([2.0, 4.0, 6.0, 8.0]), 2), [2.0, 3.0, 5.0, 7.0])


@pytest.mark.parametrize("count", [4])
def test_paths_are_drawn_over_any_number_of_scenes(tmp_path, count):
    panels = []
    for index in range(count):
        scene = families.draw("ood-all", "test", index)
        points = np.linspace((scene.start.x_m, scene.start.y_m), scene.goal, 10)
        panels.append((scene, [Track(points, Outcome.SUCCESS, "one"), Track(points + 1, Outcome.COLLISION, "two")]))
    figures.draw_paths(panels, 25.0, tmp_path / "paths.png")
    assert imread(tmp_path / "paths.png").std() > 0


def test_a_paths_colour_tells_how_it_ended(tmp_path):
    scene = families.draw("singleton", "test", 0)
    points = np.linspace((-10, 10), (10, 10), 50)
    pictures = []
    for outcome in (Outcome.SUCCESS, Outcome.COLLISION):
        figures.draw_paths([(scene, [Track(points, outcome, "")])], 25.0, tmp_path / "one.png")
        pictures.append(imread(tmp_path / "one.png")[..., :3])
    changed = np.abs(pictures[0] - pictures[1]).sum(-1) > 0.5
    assert pictures[0][changed][:, 1].mean() > pictures[0][changed][:, 0].mean()  # green where it succeeded
    assert pictures[1][changed][:, 0].mean() > pictures[1][changed][:, 1].mean()  # red where it collided


def test_curves_are_drawn_from_the_lines_of_a_run(tmp_path):
    episodes = [{"return": -100.0 + i, "outcome": "success" if i % 2 else "timeout"} for i in range(12)]
    figures.draw_curves(episodes, 5, tmp_path / "curve.png")
    assert imread(tmp_path / "curve.png").std() > 0
