import numpy as np
import pytest

from zsdist.planning.belief import BeliefMap
from zsdist.planning.grid import Grid
from zsdist.types import Pose, View
from zsdist.vision import rays
from zsdist.vision.ray_ablation import ablate_rays

ANGLES = rays.ray_angles_rad(rays.RAYS, np.pi / 2)
DISTANCES = np.linspace(1.0, 4.0, rays.RAYS)
VIEW = View(
    advice=np.array([1.0, 0.5, -0.5], np.float32),
    clearance_m=np.array([2.0, 1.0, 5.0], np.float32),
    dynamic=np.zeros(3, np.float32),
    ray_probabilities=rays.soft_labels(DISTANCES),
    ray_angles_rad=ANGLES,
    bin_edges_m=rays.BIN_EDGES_M,
)


def test_all_rays_are_the_view_itself():
    assert ablate_rays(VIEW, "all") is VIEW


def test_three_rays_tell_nothing_but_the_clearance_of_their_direction():
    said = rays.quantile_m(ablate_rays(VIEW, "three").ray_probabilities, 0.5)
    left, right = said[ANGLES > 0.3], said[ANGLES < -0.3]
    assert len(np.unique(said)) == 3
    assert left == pytest.approx(1.0, abs=0.1) and right == pytest.approx(5.0)
    assert said[np.abs(ANGLES) < 0.2] == pytest.approx(2.0, abs=0.2)
    assert (ablate_rays(VIEW, "three").advice == VIEW.advice).all()


def test_without_rays_a_map_learns_where_the_car_stands_and_nothing_else():
    grid, pose = Grid(), Pose(0.0, 0.0, 0.0)
    looked, stood = BeliefMap(grid), BeliefMap(grid)
    view = ablate_rays(VIEW, "none")
    looked.update(pose, view, 1.0)
    stood.clear_car(pose)
    assert (looked.seen() == stood.seen()).all() and not looked.occupied().any()
    assert not view.advice.any()
