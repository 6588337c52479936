"""Compiled measurements about the car: clearances, what lies along lines and straight runs, and shares of blocks."""

import math

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.planning.footprint import ADVANCES, TURNS
from zsdist.planning.forward_search import spread_costs
from zsdist.planning.grid import STEPS

DIRECTIONS = 16  # about the car, counter-clockwise from its heading
SIGHT_M = 5.0
ACTIONS = len(TURNS)
RUN_CELLS = 8
NEAR_M, FAR_M = 2.5, 5.0  # driven on
LONG_WAY_M = 4 * SIGHT_M  # longer ways, and what no way leads to, are all alike
ACTION_FEATURES, BLOCK_FEATURES = 12, 14
_TURNS = np.array(TURNS)
_ADVANCES = np.array(ADVANCES)
_STEPS = np.asarray(STEPS)
# Lines that a body of the car's width takes along. Cell centres are corners of fine squares, so none runs through one.
_CORRIDOR_M = (-0.6, -0.3, -0.02, 0.02, 0.3, 0.6)
_BODY_M = 0.6  # corridors begin beside the car
_LINE_POINTS = 33


@compiled()
def clearances(occupied, seen, x, y, heading, arena_half, grid_half, square):  # noqa: ANN001, ANN201
    """Room for the car's width, and distance to unseen ground, in each direction.

    Args:
        occupied: `(fine_size, fine_size)` bool.
        seen: `(fine_size, fine_size)` bool.
        x: of the car, metres.
        y: of the car, metres.
        heading: radians.
        arena_half: half the side of the fine frame.
        grid_half: half the side of the planning grid, beyond which the car cannot go.
        square: side of a fine square.

    Returns:
        `(2, DIRECTIONS)` metres, at most `SIGHT_M`.
    """
    out = np.full((2, DIRECTIONS), SIGHT_M)
    size = occupied.shape[0]
    for direction in range(DIRECTIONS):
        angle = heading + direction * 2 * math.pi / DIRECTIONS
        cosine, sine = math.cos(angle), math.sin(angle)
        room, known = SIGHT_M, SIGHT_M
        distance = square / 2
        while distance < room:
            px, py = x + distance * cosine, y + distance * sine
            if abs(px) >= grid_half or abs(py) >= grid_half:
                room = distance
                break
            for lateral in _CORRIDOR_M:
                fx = int((px - lateral * sine + arena_half) / square)
                fy = int((py + lateral * cosine + arena_half) / square)
                outside = fx < 0 or fy < 0 or fx >= size or fy >= size
                if distance >= _BODY_M and (outside or occupied[fy, fx]):
                    room = distance
                if abs(lateral) < 0.1 and known == SIGHT_M and not outside and not seen[fy, fx]:
                    known = distance
            distance += square
        out[0, direction], out[1, direction] = room, min(known, SIGHT_M)
    return out


@compiled()
def action_features(
    blocked: np.ndarray,
    after_each: np.ndarray,
    action_costs: np.ndarray,
    seen: np.ndarray,
    visits: np.ndarray,
    ix: int,
    iy: int,
    heading: int,
    sub_x: float,
    sub_y: float,
    cell: float,
    grid_half: float,
    border: int,
) -> np.ndarray:
    """What each action leads to, as far as can be told without planning: `(ACTIONS, ACTION_FEATURES)`.

    Columns: free, gain towards the subgoal (in cells' diagonals), cosine and sine of the subgoal's bearing
    afterwards, length of the free run straight on, most gain along it, most gain within `NEAR_M` driven on by any free
    way, the same within `FAR_M`, visits of the cell and of the state at the end, unseen share and fresh share of the
    run. Gains are in metres as the crow flies, so a subgoal behind an obstacle may gain nothing by the way round it.
    """
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
        length, nearest, unseen, fresh = _run(blocked, seen, visits, ex, ey, h, sub_x, sub_y, cell, grid_half, border)
        row[4], row[5] = length / SIGHT_M, (before - min(nearest, after)) / SIGHT_M
        spread_costs(flat, after_each, action_costs, (ey * cells + ex) * 8 + h, FAR_M, driven)
        near_by, far_by = after, after
        reach = int(FAR_M / cell) + 1  # cells; no way of that length leads farther
        for cy in range(max(ey - reach, 0), min(ey + reach + 1, cells)):
            for cx in range(max(ex - reach, 0), min(ex + reach + 1, cells)):
                driven_m = np.inf
                for state in range((cy * cells + cx) * 8, (cy * cells + cx) * 8 + 8):
                    driven_m = min(driven_m, driven[state])
                    driven[state] = np.inf  # for the next action
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
def block_shares(squares: np.ndarray, border: int, side: int, blocks: int, bx: int, by: int) -> np.ndarray:
    """Share of the squares that are set, of a block and of those about it, `[by, bx]` `(blocks, blocks)`; 0 elsewhere.

    Args:
        squares: `(fine_size, fine_size)` bool.
        border: squares between the arena's wall and the first block.
        side: squares along the side of a block.
        blocks: per side.
        bx: column of the block.
        by: row of the block.
    """
    shares = np.zeros((blocks, blocks))
    for row in range(max(by - 1, 0), min(by + 2, blocks)):
        for column in range(max(bx - 1, 0), min(bx + 2, blocks)):
            count, left = 0, border + column * side
            for fy in range(border + row * side, border + (row + 1) * side):
                across = squares[fy, left : left + side]
                for fx in range(len(across)):
                    count += 1 if across[fx] else 0
            shares[row, column] = count / side**2
    return shares


@compiled()
def block_features(
    exists: np.ndarray,
    mask: np.ndarray,
    blocks: np.ndarray,
    subgoals: np.ndarray,
    onward: np.ndarray,
    on_m: np.ndarray,
    goal_m: float,
    seen: np.ndarray,
    occupied: np.ndarray,
    block_visits: np.ndarray,
    tries: np.ndarray,
    drive_m: np.ndarray,
    squares: np.ndarray,
    seen_squares: np.ndarray,
    x: float,
    y: float,
    heading: float,
    cell: float,
    grid_half: float,
    arena_half: float,
    square: float,
) -> np.ndarray:
    """What there is of each neighbouring block, `(NEIGHBOURS, BLOCK_FEATURES)`; all 0 where it does not exist.

    Columns: exists, can be chosen, seen share, occupied share, visits, tries, detour by its subgoal, cosine and sine of
    the subgoal's bearing, way there, gain towards the goal as the crow flies, whether it is the goal's block, free
    share of the line to the subgoal, `onward`.

    Args:
        exists: of `Choices`, as are the next four; the last row is the goal.
        mask: see there.
        blocks: see there.
        subgoals: see there.
        onward: see there.
        on_m: `(9,)` from each subgoal to the goal, metres as the crow flies.
        goal_m: from the car to the goal.
        seen: share of each block's squares, `[by, bx]`.
        occupied: the same.
        block_visits: of `Situation`, as are the next two.
        tries: see there.
        drive_m: see there.
        squares: `(fine_size, fine_size)` bool, occupied.
        seen_squares: `(fine_size, fine_size)` bool.
        x: of the car, metres.
        y: of the car, metres.
        heading: of the car, radians.
        cell: side of a cell.
        grid_half: half the side of the grid.
        arena_half: half the side of the fine frame.
        square: side of a fine square.
    """
    goal = len(exists) - 1
    out = np.zeros((goal, BLOCK_FEATURES))
    for k in range(goal):
        if not exists[k]:
            continue
        bx, by = blocks[k]
        sub_x, sub_y = subgoals[k]
        there_m = min(drive_m[int((sub_y + grid_half) / cell), int((sub_x + grid_half) / cell)], LONG_WAY_M)
        bearing = math.atan2(sub_y - y, sub_x - x) - heading
        row = out[k]
        row[0], row[1], row[2], row[3] = 1.0, mask[k], seen[by, bx], occupied[by, bx]
        row[4], row[5] = math.log1p(block_visits[by, bx]), math.log1p(tries[by, bx])
        row[6] = min(there_m + on_m[k] - goal_m, LONG_WAY_M) / SIGHT_M
        row[7], row[8] = math.cos(bearing), math.sin(bearing)
        row[9], row[10] = there_m / SIGHT_M, (goal_m - on_m[k]) / SIGHT_M
        row[11] = bx == blocks[goal, 0] and by == blocks[goal, 1]
        row[12] = line(squares, seen_squares, x, y, sub_x, sub_y, arena_half, square)[0]
        row[13] = onward[k]
    return out


@compiled()
def line(occupied, seen, x, y, to_x, to_y, arena_half, square):  # noqa: ANN001, ANN201
    """How far along the straight line to a point nothing is occupied, and how much of it was seen, as shares.

    Two lines close beside it, since the line itself may run along the edges of squares.

    Args:
        occupied: `(fine_size, fine_size)` bool.
        seen: `(fine_size, fine_size)` bool.
        x: where the line begins, metres.
        y: where the line begins, metres.
        to_x: the point, metres.
        to_y: the point, metres.
        arena_half: half the side of the fine frame.
        square: side of a fine square.
    """
    east, north = to_x - x, to_y - y
    aside = 0.02 / max(math.hypot(east, north), 1e-9)
    free, known = 1.0, 0
    for side in (-aside, aside):
        met = False
        for step in range(_LINE_POINTS):
            along = step / (_LINE_POINTS - 1)
            fx = int((x + along * east - side * north + arena_half) / square)
            fy = int((y + along * north + side * east + arena_half) / square)
            known += seen[fy, fx]
            if occupied[fy, fx] and not met:
                met = True
                free = min(free, step / _LINE_POINTS)
    return free, known / (2 * _LINE_POINTS)


@compiled()
def _run(blocked, seen, visits, x, y, h, sub_x, sub_y, cell, grid_half, border):  # noqa: ANN001, ANN202
    """Straight on from a state while nothing blocks: metres, nearest to the subgoal, unseen and fresh shares."""
    length, nearest, unseen, fresh, count = 0.0, 1e9, 0, 0, 0
    step = cell * math.hypot(_STEPS[h, 0], _STEPS[h, 1])
    for _ in range(RUN_CELLS + 1):
        px, py = (x + 0.5) * cell - grid_half, (y + 0.5) * cell - grid_half
        nearest = min(nearest, math.hypot(sub_x - px, sub_y - py))
        count += 1
        fx, fy = border + 4 * x + 1, border + 4 * y + 1
        for near in range(4):  # the squares about the cell's centre
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
