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


def test_all_rays_leave_the_view_unchanged():
    assert ablate_rays(VIEW, "all") is VIEW


def test_three_rays_contain_only_the_clearance_of_their_direction():
    distance_m = rays.quantile_m(ablate_rays(VIEW, "three").ray_probabilities, 0.5)
    left, right = distance_m[ANGLES > 0.3], distance_m[ANGLES < -0.3]
    assert len(np.unique(distance_m)) == 3
    assert left == pytest.approx(1.0, abs=0.1) and right == pytest.approx(5.0)
    assert distance_m[np.abs(ANGLES) < 0.2] == pytest.approx(2.0, abs=0.2)
    assert (ablate_rays(VIEW, "three").advice == VIEW.advice).all()


def test_without_rays_a_map_learns_only_the_car_position():
    grid, pose = Grid(), Pose(0.0, 0.0, 0.0)
    updated, cleared = BeliefMap(grid), BeliefMap(grid)
    view = ablate_rays(VIEW, "none")
    updated.update(pose, view, 1.0)
    cleared.clear_car(pose)
    assert (updated.seen() == cleared.seen()).all() and not updated.occupied().any()
    assert not view.advice.any()
