import math

import numpy as np
import pytest

from zsdist.planning.footprint import ACTIONS, CAR_LENGTH_M, CAR_WIDTH_M, MARGIN_M, FootprintTable, successor
from zsdist.planning.grid import HEADINGS, Grid
from zsdist.types import Action, LatticeState

GRID = Grid()
TABLE = FootprintTable(GRID)
FREE = np.zeros((160, 160), dtype=bool)


def boxes_along(heading, action):
    """Return poses during an action, relative to the start cell's centre, independent of the table's own sampling."""
    turn = {0: 0, 1: 1, 2: -1, 3: 2, 4: -2}[action] * math.pi / 4
    angle = heading * math.pi / 4
    poses = [(0.0, 0.0, angle + turn * t) for t in np.linspace(0, 1, 37)]
    if action < 3:
        dx, dy = round(math.cos(angle + turn)), round(math.sin(angle + turn))
        poses += [(0.625 * dx * t, 0.625 * dy * t, angle + turn) for t in np.linspace(0, 1, 23)]
    return poses


def fine_cells_of(pose, half_l, half_w, count=41):
    """Return the fine cells in which points of the box lie."""
    x, y, angle = pose
    u, v = np.meshgrid(np.linspace(-half_l, half_l, count), np.linspace(-half_w, half_w, count))
    px = x + u * math.cos(angle) - v * math.sin(angle)
    py = y + u * math.sin(angle) + v * math.cos(angle)
    shrink = 1 - 1e-9  # a point exactly on an edge belongs to both cells
    return set(
        zip(np.floor(px.ravel() * shrink / GRID.fine_m), np.floor(py.ravel() * shrink / GRID.fine_m), strict=True)
    )


@pytest.mark.parametrize("heading", range(HEADINGS))
@pytest.mark.parametrize("action", range(ACTIONS))
def test_a_footprint_holds_every_point_of_the_moving_grown_box_and_hardly_more(heading, action):
    swept = {tuple(offset) for offset in TABLE.swept(heading, action)}
    half = CAR_LENGTH_M / 2 + MARGIN_M, CAR_WIDTH_M / 2 + MARGIN_M
    touched = set().union(*(fine_cells_of(pose, *half) for pose in boxes_along(heading, action)))
    assert touched <= swept
    assert len(swept - touched) <= 0.06 * len(swept)


def test_a_turn_then_advance_ends_where_the_new_heading_points():
    assert successor(LatticeState(5, 5, 0), Action.FORWARD) == LatticeState(6, 5, 0)
    assert successor(LatticeState(5, 5, 0), Action.LEFT_45) == LatticeState(6, 6, 1)
    assert successor(LatticeState(5, 5, 0), Action.RIGHT_45) == LatticeState(6, 4, 7)
    assert successor(LatticeState(5, 5, 0), Action.TURN_LEFT_90) == LatticeState(5, 5, 2)
    assert successor(LatticeState(0, 5, 4), Action.FORWARD) == LatticeState(-1, 5, 4)


def test_an_action_is_blocked_where_its_footprint_meets_an_occupied_cell():
    rng = np.random.default_rng(3)
    occupancy = rng.random((160, 160)) < 0.002
    blocked = TABLE.blocked(occupancy)
    padded = np.pad(occupancy, 20, constant_values=True)
    for iy in range(32):
        for ix in range(32):
            heading, action = int(rng.integers(8)), int(rng.integers(5))
            dx, dy = TABLE.swept(heading, action).T
            hit = padded[20 + 18 + 4 * iy + dy, 20 + 18 + 4 * ix + dx].any()
            end = successor(LatticeState(ix, iy, heading), action)
            assert blocked[iy, ix, heading, action] == (hit or not GRID.on_grid(end.ix, end.iy))


def test_in_an_empty_arena_only_leaving_the_grid_is_blocked():
    blocked = TABLE.blocked(FREE)
    assert not blocked[1:-1, 1:-1].any()
    assert blocked[:, 31, 0, Action.FORWARD].all() and blocked[31, :, 2, Action.FORWARD].all()
    assert not blocked[:, :, :, Action.TURN_LEFT_90].any()


def test_an_arena_without_a_border_blocks_where_the_car_would_leave_it():
    bare = Grid(arena_m=20.0)
    blocked = FootprintTable(bare).blocked(np.zeros((bare.fine_size, bare.fine_size), dtype=bool))
    assert blocked[0, 16, 0, Action.FORWARD] and blocked[0, 16, 0, Action.TURN_LEFT_90]
    assert not blocked[16, 16].any()


def test_one_fine_cell_within_the_margin_blocks_an_advance_and_one_beyond_it_does_not():
    beside = FREE.copy()
    beside[18 + 40 + 4, 18 + 40] = True  # 0.625 m north of the centre of cell (10, 10): half the width is 0.645
    assert TABLE.blocked(beside)[10, 10, 0, Action.FORWARD]
    beside = FREE.copy()
    beside[18 + 40 + 5, 18 + 40] = True
    assert not TABLE.blocked(beside)[10, 10, 0, Action.FORWARD]
    assert TABLE.blocked(beside)[10, 10, 2, Action.FORWARD]


@pytest.mark.parametrize("cells", [8, 32, 48, 100])
def test_every_size_of_grid_is_covered(cells):
    grid = Grid(cells=cells, arena_m=cells * 0.625 + 5.0)
    occupancy = np.zeros((grid.fine_size, grid.fine_size), dtype=bool)
    rng = np.random.default_rng(cells)
    centres = rng.integers(0, cells, (40, 2))
    for ix, iy in centres:
        occupancy[grid.fine_border + 4 * iy + 2, grid.fine_border + 4 * ix + 2] = True
    blocked = FootprintTable(grid).blocked(occupancy)
    near = np.zeros((cells, cells), dtype=bool)
    for ix, iy in centres:
        assert blocked[iy, ix].all(), "an occupied cell under the car blocks every action"
        near[max(iy - 6, 0) : iy + 7, max(ix - 6, 0) : ix + 7] = True
    inner = np.zeros_like(near)
    inner[1:-1, 1:-1] = True
    assert not blocked[inner & ~near].any()


def test_an_occupancy_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"allowed is \(160, 160\)"):
        TABLE.blocked(np.zeros((32, 32), dtype=bool))


def test_a_car_too_long_for_the_table_is_refused():
    with pytest.raises(ValueError, match=r"allowed is 10\.00 m at most"):
        FootprintTable(GRID, length_m=20.0)
