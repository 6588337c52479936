"""Scenes from occupancy maps and maps from scenes: windows of the arena's size, with a start and a goal in each."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from zsdist.errors import SceneError
from zsdist.planning.grid import HEADINGS, Grid
from zsdist.planning.shortest_path import cost_to_go, goal_mask, metres_cost
from zsdist.sim.maps import kernels
from zsdist.sim.maps.cover import Slab, cover
from zsdist.sim.maps.nav2 import LETHAL, OccupancyMap
from zsdist.sim.physics.collision import clearance_m
from zsdist.sim.scenes.families_canvas import START_CLEARANCE_M
from zsdist.sim.scenes.kinds import WALL_HEIGHT_M
from zsdist.sim.scenes.scene import DEFAULT_GRID, MAX_OBSTACLES, Obstacle, Scene, Start, check
from zsdist.sim.scenes.solvability import SUCCESS_RADIUS_M, footprints
from zsdist.types import LatticeState, Pose

TOLERANCES_M = (0.05, 0.1, 0.2)  # greatest distance of shapes from the map; the later ones where it is too ragged
RESOLUTION_M = 0.01  # of written maps
LEAST_WAYS_M = (10.0, 6.0, 3.0)  # least distance between start and goal; the later ones where there is no room
_GOALS_TRIED = 20
_DIGITS = 4  # of written positions and sizes, in metres


@dataclass(frozen=True)
class ObstacleRules:
    """Rules by which the cells of a map become obstacles.

    Attributes:
        unknown_occupied: whether unknown cells are obstacles; doubtful ones count as unknown then.
        lethal: least occupancy of an obstacle, Nav2's `lethal_cost_threshold`.
    """

    unknown_occupied: bool = False
    lethal: int = LETHAL


@dataclass(frozen=True)
class Window:
    """Part of a map that fits into the arena.

    Attributes:
        centre: its middle in the map's frame, `(x_m, y_m)`; the scene's origin.
        obstacles: obstacles in the scene's frame, whose axes are those of the map's frame.
        tolerance_m: greatest distance between them and the map.
    """

    centre: tuple[float, float]
    obstacles: tuple[Obstacle, ...]
    tolerance_m: float


def centres(found: OccupancyMap, grid: Grid = DEFAULT_GRID) -> list[tuple[float, float]]:
    """Return the middles of windows whose planning grids cover the known part of a map, row by row from the south.

    A map that fits into the arena is one window.

    Raises:
        SceneError: no cell of the map is known.
    """
    known = (found.cells >= 0) & ~found.doubtful
    rows, columns = np.flatnonzero(known.any(1)), np.flatnonzero(known.any(0))
    if not len(rows):
        raise SceneError(f"map {found.name} has no known cell; is its picture or its thresholds the right ones?")
    corners = np.array(
        [
            found.to_world(column * found.resolution_m, row * found.resolution_m)
            for column in (columns[0], columns[-1] + 1)
            for row in (rows[0], rows[-1] + 1)
        ]
    )
    along_x, along_y = (_middles(low, high, grid) for low, high in zip(corners.min(0), corners.max(0), strict=True))
    return [(x, y) for y in along_y for x in along_x]


def _middles(low: float, high: float, grid: Grid) -> list[float]:
    low, extent = float(low), float(high - low)
    if extent <= grid.arena_m + 1e-6:
        return [round(low + extent / 2, _DIGITS)]
    count = math.ceil(extent / grid.side_m - 1e-6)
    step = (extent - grid.side_m) / (count - 1)
    return [round(low + grid.side_m / 2 + step * index, _DIGITS) for index in range(count)]


def cut(found: OccupancyMap, centre: tuple[float, float], reading: ObstacleRules, grid: Grid = DEFAULT_GRID) -> Window:
    """Return the window of a map around a point, with its obstacles as boxes and rocks.

    Raises:
        SceneError: its obstacles are too many, even with the greatest tolerance.
    """
    half, cell_m = grid.arena_m / 2, found.resolution_m
    corners_x = np.array([centre[0] + dx for dx in (-half, half) for _ in range(2)])
    corners_y = np.array([centre[1] + dy for _ in range(2) for dy in (-half, half)])
    along, up = found.to_picture(corners_x, corners_y)
    first_column, first_row = math.floor(along.min() / cell_m + 1e-6), math.floor(up.min() / cell_m + 1e-6)
    columns, rows = (math.ceil(side.max() / cell_m - 1e-6) for side in (along, up))
    occupied = _obstructed(found, (first_row, rows), (first_column, columns), reading)
    occupied &= _inside(found, centre, half, (first_row, rows), (first_column, columns))
    for tolerance_m in TOLERANCES_M:
        try:
            shapes = cover(occupied, cell_m, tolerance_m, MAX_OBSTACLES)
            break
        except SceneError as error:
            if tolerance_m == TOLERANCES_M[-1]:
                at = f"({centre[0]:g}, {centre[1]:g})"
                raise SceneError(f"map {found.name} around {at}: {error}, even {tolerance_m:g} m from it") from error
    obstacles = []
    for shape in shapes:
        x_m, y_m = found.to_world(first_column * cell_m + shape.x_m, first_row * cell_m + shape.y_m)
        x_m, y_m = (
            round(float(min(max(value - middle, -half), half)), _DIGITS)
            for value, middle in zip((x_m, y_m), centre, strict=True)
        )
        if isinstance(shape, Slab):
            heading_deg = round(math.degrees(shape.angle_rad + found.origin[2]) % 360.0, 3)
            size_m = (round(shape.length_m, _DIGITS), round(shape.width_m, _DIGITS), WALL_HEIGHT_M)
            obstacles.append(Obstacle("box", x_m, y_m, None, size_m, heading_deg))
        else:
            obstacles.append(Obstacle("rock", x_m, y_m, round(shape.radius_m, _DIGITS)))
    return Window(centre, tuple(obstacles), tolerance_m)


def _obstructed(
    found: OccupancyMap, rows: tuple[int, int], columns: tuple[int, int], reading: ObstacleRules
) -> np.ndarray:
    """Return which cells are obstacles, in a part of a map that may reach beyond its edges; unknown out there."""
    occupied = found.cells >= reading.lethal
    if reading.unknown_occupied:
        occupied |= (found.cells < 0) | found.doubtful
    part = np.full((rows[1] - rows[0], columns[1] - columns[0]), reading.unknown_occupied)
    high, wide = occupied.shape
    top, bottom, left, right = max(rows[0], 0), min(rows[1], high), max(columns[0], 0), min(columns[1], wide)
    if top < bottom and left < right:
        part[top - rows[0] : bottom - rows[0], left - columns[0] : right - columns[0]] = occupied[
            top:bottom, left:right
        ]
    return part


def _inside(
    found: OccupancyMap, centre: tuple[float, float], half_m: float, rows: tuple[int, int], columns: tuple[int, int]
) -> np.ndarray:
    """Return which cells have their middle in the square around a point, whose sides lie along the map's frame."""
    along = (np.arange(*columns) + 0.5)[None, :] * found.resolution_m
    up = (np.arange(*rows) + 0.5)[:, None] * found.resolution_m
    x, y, yaw = found.origin
    if not yaw:  # without a turn, rows and columns are apart
        return (np.abs(x + along - centre[0]) <= half_m) & (np.abs(y + up - centre[1]) <= half_m)
    cos, sin = math.cos(yaw), math.sin(yaw)
    x_m, y_m = x + along * cos - up * sin, y + along * sin + up * cos
    return (np.abs(x_m - centre[0]) <= half_m) & (np.abs(y_m - centre[1]) <= half_m)


def known_free(found: OccupancyMap, centre: tuple[float, float], grid: Grid = DEFAULT_GRID) -> np.ndarray:
    """Return which cells of the planning grid have their middle on known free ground, `[iy, ix]` bool."""
    xs, ys = grid.cell_centres()
    along, up = found.to_picture(xs[None, :] + centre[0], ys[:, None] + centre[1])
    column, row = (np.floor(value / found.resolution_m).astype(int) for value in (along, up))
    high, wide = found.cells.shape
    on_map = (row >= 0) & (row < high) & (column >= 0) & (column < wide)
    row, column = row.clip(0, high - 1), column.clip(0, wide - 1)
    cells = found.cells[row, column]
    return on_map & (cells >= 0) & (cells < LETHAL) & ~found.doubtful[row, column]


def ends(
    obstacles: Sequence[Obstacle], allowed: np.ndarray, rng: np.random.Generator, grid: Grid = DEFAULT_GRID
) -> Iterator[tuple[Start, tuple[float, float]]]:
    """Yield pairs of a start and a goal with a way between them, far apart, without end.

    Both are `START_CLEARANCE_M` from every obstacle, and apart by the greatest of `LEAST_WAYS_M` for which a pair is
    found. Nothing is yielded where there is none.

    Args:
        obstacles: obstacles of the scene.
        allowed: cells in which start and goal may be, `[iy, ix]` bool.
        rng: source of the choice.
        grid: planning grid.
    """
    empty = Scene("", "asphalt", Start(0.0, 0.0, 0.0), (0.0, 0.0), tuple(obstacles))
    circles, boxes = empty.circles(), empty.boxes()
    xs, ys = grid.cell_centres()
    room = [(ix, iy) for iy, ix in np.argwhere(allowed).tolist()]
    room = [
        (ix, iy)
        for ix, iy in room
        if clearance_m(Pose(xs[ix], ys[iy], 0.0), circles, boxes, 0.0, 0.0, grid.arena_m) >= START_CLEARANCE_M
    ]
    if len(room) < 2:
        return
    blocked, costs = footprints(grid).blocked(empty.occupancy(grid)), metres_cost(grid)
    clear = np.zeros_like(allowed)
    clear[[iy for _, iy in room], [ix for ix, _ in room]] = True
    failed, ways = 0, list(LEAST_WAYS_M)
    while ways:
        goal = grid.centre(*room[int(rng.integers(len(room)))])
        field = cost_to_go(blocked, goal_mask(grid, goal, SUCCESS_RADIUS_M), costs)
        far = np.hypot(xs[None, :] - goal[0], ys[:, None] - goal[1]) >= ways[0]
        starts = np.argwhere(np.isfinite(field) & (clear & far)[..., None])
        if not len(starts):
            failed += 1
            if failed == _GOALS_TRIED:
                failed = 0
                ways.pop(0)
            continue
        failed = 0
        iy, ix, heading = starts[int(rng.integers(len(starts)))].tolist()
        state = LatticeState(ix, iy, heading)
        yield Start(*grid.centre(state.ix, state.iy), state.heading * 360.0 / HEADINGS), goal


def scenes_of(
    found: OccupancyMap,
    reading: ObstacleRules,
    count: int | None,
    rng: np.random.Generator,
    ground: str,
    grid: Grid = DEFAULT_GRID,
) -> tuple[list[tuple[Scene, Window]], list[tuple[float, float]]]:
    """Return scenes of a map, in turn from each window that has a start and a goal.

    Args:
        found: the map.
        reading: rules of obstacles.
        count: number of scenes; None: one for each window.
        rng: source of starts and goals.
        ground: kind of ground.
        grid: planning grid.

    Returns:
        The scenes with their windows; and the middles of windows without a start and a goal.

    Raises:
        SceneError: no window has a start and a goal.
    """
    usable, unusable = [], []
    for centre in centres(found, grid):
        allowed = known_free(found, centre, grid)
        window = cut(found, centre, reading, grid) if allowed.any() else None
        pairs = ends(window.obstacles, allowed, rng, grid) if window else iter(())
        first = next(pairs, None)
        if window is None or first is None:
            unusable.append(centre)
        else:
            usable.append((window, first, pairs))
    if not usable:
        raise SceneError(
            f"map {found.name} has no start and goal: two places of known free ground, {LEAST_WAYS_M[-1]:g} m apart, "
            f"{START_CLEARANCE_M:g} m from every obstacle, with a way for the car between them; give --start and "
            "--goal, and `check` shows where it is too narrow"
        )
    wanted = len(usable) if count is None else count
    made: list[tuple[Scene, Window]] = []
    for index in range(wanted):
        window, first, pairs = usable[index % len(usable)]
        start, goal = first if index < len(usable) else next(pairs, first)
        scene = Scene(_name(found, index, wanted), ground, start, goal, window.obstacles)
        check(scene, grid)
        made.append((scene, window))
    return made, unusable


def scene_between(
    found: OccupancyMap,
    reading: ObstacleRules,
    start: Start,
    goal: tuple[float, float],
    ground: str,
    grid: Grid = DEFAULT_GRID,
) -> tuple[Scene, Window]:
    """Return the scene of a map with a given start and goal, both in the map's frame.

    Raises:
        SceneError: they are too far apart for one scene, or not on free ground.
    """
    middles = centres(found, grid)
    at = middles[0] if len(middles) == 1 else ((start.x_m + goal[0]) / 2, (start.y_m + goal[1]) / 2)
    centre = (round(at[0], _DIGITS), round(at[1], _DIGITS))
    window = cut(found, centre, reading, grid)
    moved = Start(round(start.x_m - centre[0], _DIGITS), round(start.y_m - centre[1], _DIGITS), start.heading_deg)
    target = (round(goal[0] - centre[0], _DIGITS), round(goal[1] - centre[1], _DIGITS))
    scene = Scene(_name(found, 0, 1), ground, moved, target, window.obstacles)
    check(scene, grid)
    return scene, window


def _name(found: OccupancyMap, index: int, count: int) -> str:
    name = re.sub(r"[^\w. -]", "_", found.name)[:90].lstrip("._ -") or "map"
    return name if count == 1 else f"{name}-{index:03d}"


def occupied_cells(scene: Scene, resolution_m: float = RESOLUTION_M, grid: Grid = DEFAULT_GRID) -> np.ndarray:
    """Return the cells of a map of the arena whose middle is in a standing obstacle, `[row, column]` bool from below.

    Walking people are left out. The arena's walls are the edges of the map.
    """
    size = round(grid.arena_m / resolution_m)
    marks = np.zeros((size, size), np.int16)
    half = grid.arena_m / 2
    for x, y, radius in scene.standing_circles():
        kernels.mark_disc(marks, (x + half) / resolution_m, (y + half) / resolution_m, radius / resolution_m, 1)
    for x, y, length, width, angle in scene.boxes():
        at = ((x + half) / resolution_m, (y + half) / resolution_m)
        kernels.mark_box(marks, *at, length / 2 / resolution_m, width / 2 / resolution_m, angle, 1)
    return marks > 0
