import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsdist.config import GridConfig
from zsdist.errors import ConfigError
from zsdist.planning.grid import HEADINGS, STEPS, Grid
from zsdist.types import LatticeState, Pose

GRID = Grid.from_config(GridConfig())
on_grid = st.floats(-10.0, 10.0, exclude_max=True)


@given(on_grid, on_grid)
def test_eq07_every_point_on_the_grid_lies_in_exactly_one_of_m_times_m_cells(x_m, y_m):
    ix, iy = GRID.cell_at(x_m, y_m)
    assert GRID.on_grid(ix, iy)
    cx, cy = GRID.centre(ix, iy)
    assert abs(cx - x_m) <= 0.3125 + 1e-9 and abs(cy - y_m) <= 0.3125 + 1e-9


def test_eq07_cells_are_32_by_32_of_0_625_m_and_their_centres_map_back_to_them():
    cells = {(ix, iy) for ix in range(32) for iy in range(32)}
    assert {GRID.cell_at(*GRID.centre(*cell)) for cell in cells} == cells
    assert GRID.centre(0, 0) == (-9.6875, -9.6875)
    assert GRID.centre(31, 31) == (9.6875, 9.6875)


@pytest.mark.parametrize("point", [(-10.01, 0.0), (10.0, 0.0), (0.0, 10.0), (0.0, -11.0), (math.nan, 0.0)])
def test_a_point_off_the_grid_has_no_cell(point):
    assert not GRID.contains(*point)
    with pytest.raises(ValueError, match="off the grid"):
        GRID.cell_at(*point)


def test_blocks_partition_the_cells_into_4_by_4_of_8_by_8():
    owner = np.full((32, 32, 2), -1)
    for bx in range(4):
        for by in range(4):
            rows, columns = GRID.block_cells(bx, by)
            assert (owner[rows, columns] == -1).all()
            owner[rows, columns] = (bx, by)
    assert all(tuple(owner[iy, ix]) == GRID.block_of(ix, iy) for ix in range(32) for iy in range(32))


def test_a_step_of_each_heading_points_where_the_heading_points():
    for heading in range(HEADINGS):
        assert math.atan2(STEPS[heading][1], STEPS[heading][0]) % math.tau == pytest.approx(heading * math.pi / 4)


@given(st.integers(0, 31), st.integers(0, 31), st.integers(0, 7), st.floats(-0.3, 0.3), st.floats(-0.39, 0.39))
def test_a_pose_near_a_lattice_state_rounds_to_it(ix, iy, heading, offset_m, turn_rad):
    state = LatticeState(ix, iy, heading)
    pose = GRID.pose(state)
    assert -math.pi < pose.heading_rad <= math.pi
    near = Pose(pose.x_m + offset_m, pose.y_m - offset_m, pose.heading_rad + turn_rad)
    assert GRID.lattice_state(near) == state


def test_a_pose_beyond_the_grid_rounds_to_a_cell_at_its_edge():
    assert GRID.lattice_state(Pose(11.0, -11.0, 0.0)) == LatticeState(31, 0, 0)


def test_the_fine_grid_covers_the_arena_and_cell_centres_are_corners_of_fine_cells():
    xs, ys = GRID.fine_centres()
    assert GRID.fine_size == len(xs) == len(ys) == 160
    assert xs[0] == -12.5 + GRID.fine_m / 2 and xs[-1] == 12.5 - GRID.fine_m / 2
    assert all(GRID.fine_index(x, ys[3]) == (i, 3) for i, x in enumerate(xs))
    x_m, _ = GRID.centre(5, 5)
    assert (x_m + 12.5) / GRID.fine_m == GRID.fine_border + 4 * 5 + 2


def test_sizes_that_do_not_fit_together_are_refused_by_name():
    with pytest.raises(ConfigError, match=r"grid\.arena_m is 19"):
        Grid(arena_m=19.0)
    with pytest.raises(ConfigError, match=r"grid\.blocks"):
        Grid(blocks=5)
