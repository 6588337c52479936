"""Compiled measurements around the car: clearances, contents of lines and straight runs, and features of blocks.

Values that belong together are passed as plain tuples, since numba takes several times as long to identify named ones.
"""

import math

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.footprint import ADVANCES, TURNS
from zsdist.planning.forward_search import spread_costs
from zsdist.planning.grid import FINE_PER_CELL, STEPS

DIRECTIONS = 16  # around the car, counter-clockwise from its heading
SIGHT_M = 5.0  # largest measured distance, and the unit of most length features
ACTIONS = len(TURNS)
RUN_CELLS = 8
NEAR_M, FAR_M = 2.5, 5.0  # lengths of the free paths that are followed after an action
LONG_PATH_M = 4 * SIGHT_M  # longer paths count as this long, and so do missing ones
ACTION_FEATURES, BLOCK_FEATURES = 12, 14
_TURNS = np.array(TURNS)
_ADVANCES = np.array(ADVANCES)
_STEPS = np.asarray(STEPS)
# Lateral offsets that cover a body of the car's width. None is 0, since cell centres are corners of fine cells.
_CORRIDOR_M = (-0.6, -0.3, -0.02, 0.02, 0.3, 0.6)
_BODY_M = 0.6  # corridors begin beside the car
_LINE_POINTS = 33

# `(fine_size, fine_size)` bool each: occupied fine cells, and seen ones.
FineCells = tuple[np.ndarray, np.ndarray]
# `blocked` `(cells, cells, 8, 5)` bool, `ends` of `zsdist.planning.lattice`, and the costs of actions `(8, 5)`.
Moves = tuple[np.ndarray, np.ndarray, np.ndarray]
# `exists`, `mask`, `blocks`, `subgoals` and `onward` of `zsdist.agent.blocks.Choices`; the last row is the goal.
Offer = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
# Side of a cell, half the side of the grid, half the side of the fine grid and side of a fine cell, all in metres;
# fine cells between the arena's wall and the first cell.
Geometry = tuple[float, float, float, float, int]


@compiled()
def clearances(
    occupied: np.ndarray,
    seen: np.ndarray,
    x: float,
    y: float,
    heading: float,
    arena_half: float,
    grid_half: float,
    fine: float,
) -> np.ndarray:
    """Return the free distance for a body of the car's width and the distance to unseen ground in each direction.

    Args:
        occupied: `(fine_size, fine_size)` bool, occupied fine cells.
        seen: `(fine_size, fine_size)` bool, seen fine cells.
        x: x of the car, metres.
        y: y of the car, metres.
        heading: heading of the car, radians.
        arena_half: half the side of the fine grid, metres.
        grid_half: half the side of the planning grid, beyond which the car cannot go, metres.
        fine: side of a fine cell, metres.

    Returns:
        `(2, DIRECTIONS)` metres, at most `SIGHT_M`: free distances, then distances to unseen ground.
    """
    out = np.full((2, DIRECTIONS), SIGHT_M)
    size = occupied.shape[0]
    for direction in range(DIRECTIONS):
        angle = heading + direction * 2 * math.pi / DIRECTIONS
        cosine, sine = math.cos(angle), math.sin(angle)
        room, known = SIGHT_M, SIGHT_M
        distance = fine / 2
        while distance < room:
            px, py = x + distance * cosine, y + distance * sine
            if abs(px) >= grid_half or abs(py) >= grid_half:
                room = distance
                break
            for lateral in _CORRIDOR_M:
                fx = int((px - lateral * sine + arena_half) / fine)
                fy = int((py + lateral * cosine + arena_half) / fine)
                outside = fx < 0 or fy < 0 or fx >= size or fy >= size
                if distance >= _BODY_M and (outside or occupied[fy, fx]):
                    room = distance
                if abs(lateral) < 0.1 and known == SIGHT_M and not outside and not seen[fy, fx]:
                    known = distance
            distance += fine
        out[0, direction], out[1, direction] = room, min(known, SIGHT_M)
    return out


@compiled()
def action_features(
    moves: Moves,
    seen: np.ndarray,
    visits: np.ndarray,
    ix: int,
    iy: int,
    heading: int,
    subgoal: tuple[float, float],
    geometry: Geometry,
) -> np.ndarray:
    """Return features of the outcome of each action, without planning, `(ACTIONS, ACTION_FEATURES)`.

    Columns: whether the action is free; gain towards the subgoal, in diagonals of a cell; cosine and sine of the
    subgoal's bearing afterwards; length of the free straight run that follows; largest gain along this run; largest
    gain on any free path of at most `NEAR_M` that follows; the same for `FAR_M`; logarithms of the visits of the cell
    and of the state where the action ends; unseen share and unvisited share of the run. A gain is the decrease of the
    straight distance to the subgoal, so the path around an obstacle may have none. Lengths and all gains but the first
    are in units of `SIGHT_M`. All columns are 0 for a blocked action.

    Args:
        moves: see `Moves`.
        seen: `(fine_size, fine_size)` bool, seen fine cells.
        visits: `(cells, cells, 8)` int, number of visits of each state.
        ix: column of the car's cell.
        iy: row of the car's cell.
        heading: heading of the car, in eighths of a turn.
        subgoal: `(x_m, y_m)`.
        geometry: see `Geometry`.
    """
    blocked, after_each, action_costs = moves
    sub_x, sub_y = subgoal
    cell, grid_half, _, _, border = geometry
    out = np.zeros((ACTIONS, ACTION_FEATURES))
    cells, flat = blocked.shape[0], blocked.ravel()
    driven = np.full(len(after_each), np.inf)
    x0, y0 = (ix + 0.5) * cell - grid_half, (iy + 0.5) * cell - grid_half
    before = math.hypot(sub_x - x0, sub_y - y0)
    for action in range(ACTIONS):
        if blocked[iy, ix, heading, action]:
            continue
        h = (heading + _TURNS[action]) % 8
        ex, ey = ix + _STEPS[h, 0] * _ADVANCES[action], iy + _STEPS[h, 1] * _ADVANCES[action]
        row = out[action]
        x, y = (ex + 0.5) * cell - grid_half, (ey + 0.5) * cell - grid_half
        after = math.hypot(sub_x - x, sub_y - y)
        bearing = math.atan2(sub_y - y, sub_x - x) - h * math.pi / 4
        row[0] = 1.0
        row[1] = (before - after) / (1.4142135 * cell)
        row[2], row[3] = math.cos(bearing), math.sin(bearing)
        length, nearest, unseen, fresh = _run(blocked, seen, visits, ex, ey, h, subgoal, cell, grid_half, border)
        row[4], row[5] = length / SIGHT_M, (before - min(nearest, after)) / SIGHT_M
        spread_costs(flat, after_each, action_costs, (ey * cells + ex) * 8 + h, FAR_M, driven)
        near_by, far_by = after, after
        reach = int(FAR_M / cell) + 1  # cells; no path of that length leads farther
        for cy in range(max(ey - reach, 0), min(ey + reach + 1, cells)):
            for cx in range(max(ex - reach, 0), min(ex + reach + 1, cells)):
                driven_m = np.inf
                for state in range((cy * cells + cx) * 8, (cy * cells + cx) * 8 + 8):
                    driven_m = min(driven_m, driven[state])
                    driven[state] = np.inf  # reset for the next action
                if driven_m <= FAR_M:
                    gap = math.hypot(sub_x - ((cx + 0.5) * cell - grid_half), sub_y - ((cy + 0.5) * cell - grid_half))
                    far_by = min(far_by, gap)
                    near_by = min(near_by, gap) if driven_m <= NEAR_M else near_by
        row[6], row[7] = (before - near_by) / SIGHT_M, (before - far_by) / SIGHT_M
        cell_visits = 0
        for k in range(8):
            cell_visits += visits[ey, ex, k]
        row[8], row[9] = math.log1p(cell_visits), math.log1p(visits[ey, ex, h])
        row[10], row[11] = unseen, fresh
    return out


@compiled()
def block_features(
    offer: Offer,
    beeline_m: np.ndarray,
    fine_cells: FineCells,
    counts: tuple[np.ndarray, np.ndarray],
    drive_m: np.ndarray,
    pose: tuple[float, float, float],
    block: tuple[int, int],
    geometry: Geometry,
) -> tuple[np.ndarray, float]:
    """Return the features of each neighbouring block, and the seen share of the car's own block.

    Columns: whether the block exists; whether it may be chosen; seen share; occupied share; logarithms of visits and
    tries; detour to the goal through the block's subgoal; cosine and sine of the subgoal's bearing; path length to the
    subgoal; decrease of the straight distance to the goal; whether it is the goal's block; free share of the straight
    line to the subgoal; `onward`. Lengths are in units of `SIGHT_M`.

    Args:
        offer: see `Offer`.
        beeline_m: `(10,)` straight distances to the goal in metres, from each subgoal and then from the car.
        fine_cells: see `FineCells`.
        counts: `block_visits` and `tries` of `zsdist.agent.situation.Situation`.
        drive_m: `drive_m` of the same situation.
        pose: x and y of the car in metres, and its heading in radians.
        block: `(bx, by)` of the car.
        geometry: see `Geometry`.

    Returns:
        `(NEIGHBOURS, BLOCK_FEATURES)`, all 0 where the block does not exist; and the seen share.
    """
    exists, mask, blocks, subgoals, onward = offer
    occupied, seen = fine_cells
    block_visits, tries = counts
    x, y, heading = pose
    cell, grid_half, arena_half, fine, border = geometry
    goal = len(exists) - 1
    goal_m = beeline_m[-1]
    seen_shares = _block_shares(seen, border, drive_m.shape[0], block_visits.shape[0], block)
    occupied_shares = _block_shares(occupied, border, drive_m.shape[0], block_visits.shape[0], block)
    out = np.zeros((goal, BLOCK_FEATURES))
    for k in range(goal):
        if not exists[k]:
            continue
        bx, by = blocks[k]
        sub_x, sub_y = subgoals[k]
        there_m = min(drive_m[int((sub_y + grid_half) / cell), int((sub_x + grid_half) / cell)], LONG_PATH_M)
        bearing = math.atan2(sub_y - y, sub_x - x) - heading
        row = out[k]
        row[0], row[1], row[2], row[3] = 1.0, mask[k], seen_shares[by, bx], occupied_shares[by, bx]
        row[4], row[5] = math.log1p(block_visits[by, bx]), math.log1p(tries[by, bx])
        row[6] = min(there_m + beeline_m[k] - goal_m, LONG_PATH_M) / SIGHT_M
        row[7], row[8] = math.cos(bearing), math.sin(bearing)
        row[9], row[10] = there_m / SIGHT_M, (goal_m - beeline_m[k]) / SIGHT_M
        row[11] = bx == blocks[goal, 0] and by == blocks[goal, 1]
        row[12] = line(fine_cells, x, y, sub_x, sub_y, arena_half, fine)[0]
        row[13] = onward[k]
    return out, seen_shares[block[1], block[0]]


@compiled()
def line(
    fine_cells: FineCells, x: float, y: float, to_x: float, to_y: float, arena_half: float, fine: float
) -> tuple[float, float]:
    """Return the share of a straight line before its first occupied fine cell, and the seen share of the line.

    Two lines close beside it are measured, since the line itself may run along the edges of fine cells.

    Args:
        fine_cells: see `FineCells`.
        x: x of the beginning, metres.
        y: y of the beginning, metres.
        to_x: x of the end, metres.
        to_y: y of the end, metres.
        arena_half: half the side of the fine grid, metres.
        fine: side of a fine cell, metres.
    """
    occupied, seen = fine_cells
    east, north = to_x - x, to_y - y
    aside = 0.02 / max(math.hypot(east, north), 1e-9)
    free, known = 1.0, 0
    for side in (-aside, aside):
        met = False
        for step in range(_LINE_POINTS):
            along = step / (_LINE_POINTS - 1)
            fx = int((x + along * east - side * north + arena_half) / fine)
            fy = int((y + along * north + side * east + arena_half) / fine)
            known += seen[fy, fx]
            if occupied[fy, fx] and not met:
                met = True
                free = min(free, step / _LINE_POINTS)
    return free, known / (2 * _LINE_POINTS)


@compiled()
def _block_shares(flags: np.ndarray, border: int, cells: int, blocks: int, block: tuple[int, int]) -> np.ndarray:
    """Return the share of fine cells that are set, in a block and in each of its neighbours.

    Args:
        flags: `(fine_size, fine_size)` bool.
        border: number of fine cells between the arena's wall and the first block.
        cells: number of cells per side of the grid.
        blocks: number of blocks per side of the grid.
        block: `(bx, by)` of the middle block.

    Returns:
        `(blocks, blocks)` `[by, bx]`, 0 for all other blocks.
    """
    bx, by = block
    side = cells // blocks * FINE_PER_CELL
    shares = np.zeros((blocks, blocks))
    for row in range(max(by - 1, 0), min(by + 2, blocks)):
        for column in range(max(bx - 1, 0), min(bx + 2, blocks)):
            count, left = 0, border + column * side
            for fy in range(border + row * side, border + (row + 1) * side):
                across = flags[fy, left : left + side]
                for fx in range(len(across)):
                    count += 1 if across[fx] else 0
            shares[row, column] = count / side**2
    return shares


@compiled()
def _run(
    blocked: np.ndarray,
    seen: np.ndarray,
    visits: np.ndarray,
    x: int,
    y: int,
    h: int,
    subgoal: tuple[float, float],
    cell: float,
    grid_half: float,
    border: int,
) -> tuple[float, float, float, float]:
    """Follow the heading from a state until something blocks, for at most `RUN_CELLS` cells.

    Returns:
        Length and least distance from the subgoal in metres, unseen share and unvisited share.
    """
    sub_x, sub_y = subgoal
    length, nearest, unseen, fresh, count = 0.0, 1e9, 0, 0, 0
    step = cell * math.hypot(_STEPS[h, 0], _STEPS[h, 1])
    for _ in range(RUN_CELLS + 1):
        px, py = (x + 0.5) * cell - grid_half, (y + 0.5) * cell - grid_half
        nearest = min(nearest, math.hypot(sub_x - px, sub_y - py))
        count += 1
        fx, fy = border + 4 * x + 1, border + 4 * y + 1
        for near in range(4):  # the fine cells around the cell's centre
            if not seen[fy + near // 2, fx + near % 2]:
                unseen += 1
        stood = 0
        for k in range(8):
            stood += visits[y, x, k]
        if stood == 0:
            fresh += 1
        if blocked[y, x, h, 0] or count > RUN_CELLS:
            break
        x, y = x + _STEPS[h, 0], y + _STEPS[h, 1]
        length += step
    return length, nearest, unseen / (4 * count), fresh / (RUN_CELLS + 1)
