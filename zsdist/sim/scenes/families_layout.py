"""Scenes with a layout: walls with gaps, chicanes, corridors and pockets, and streets.

The start is in the west and the goal in the east. Every passage between two walls is `PASSAGE_M` wide or more, or
closed: the car's turn in place needs 2.31 m, and it cannot reverse.
"""

import math
from dataclasses import dataclass

from zsdist.sim.scenes.families_canvas import Canvas, Redraw, draw
from zsdist.sim.scenes.scene import DEFAULT_GRID, Obstacle, Scene

PASSAGE_M = 3.0
WALL_HEIGHTS_M = (1.8, 2.6)
EDGE_M = DEFAULT_GRID.arena_m / 2
ROAD_HALF_M = (3.6, 5.0)  # least and greatest distance from the middle of a road to its kerbs
_POLE_BEHIND_KERB_M = 0.4
_CAR_FROM_KERB_M = 1.0  # distance of a car's centre from the kerb, on the road
_LINE_M = 0.03  # tolerance of a line of obstacles: positions are rounded to the centimetre


@dataclass(frozen=True)
class Road:
    """Position of a street's kerbs, which are drawn on the ground and are not obstacles.

    Attributes:
        along_x: whether the street runs along x; else it runs along y.
        middle_m: y of its middle line if it runs along x, else x.
        half_m: distance from the middle line to either kerb.
    """

    along_x: bool
    middle_m: float
    half_m: float


def walls(canvas: Canvas) -> None:
    """Add walls of a random plan; raise `Redraw` if they are too close to start or goal."""
    plan = (_gaps, _chicane, _corridor, _pockets)[int(canvas.rng.integers(4))]
    for wall in plan(canvas):
        if not canvas.clear_of_ends(wall):
            raise Redraw
        canvas.obstacles.append(wall)


def _gaps(canvas: Canvas) -> list[Obstacle]:
    """Return one or two walls across the arena, each with one or two gaps."""
    rng = canvas.rng
    xs = [rng.uniform(-4.0, 4.0)] if rng.random() < 0.4 else [rng.uniform(-4.5, -2.5), rng.uniform(2.0, 4.5)]
    pieces = []
    for x_m in xs:
        gaps = [_row(canvas, -8, 8)] if rng.random() < 0.5 else [_row(canvas, -8, -3), _row(canvas, 3, 8)]
        pieces += _across(canvas, x_m, [(y_m, rng.uniform(PASSAGE_M, 4.2)) for y_m in gaps])
    return pieces


def _chicane(canvas: Canvas) -> list[Obstacle]:
    """Return two or three walls, open alternately at the north and at the south end."""
    rng = canvas.rng
    count = int(rng.integers(2, 4))
    north = bool(rng.integers(2))
    pieces = []
    for i in range(count):
        x_m = (i - (count - 1) / 2) * (PASSAGE_M + 1.2) + rng.uniform(-0.2, 0.2)
        gap = (_row(canvas, 5, 8) if north else _row(canvas, -8, -5), rng.uniform(PASSAGE_M, 4.5))
        pieces += _across(canvas, x_m, [gap])
        north = not north
    return pieces


def _corridor(canvas: Canvas) -> list[Obstacle]:
    """Return a corridor that is the only passage from west to east."""
    rng = canvas.rng
    y_m, width_m, length_m = _row(canvas, -7, 7), rng.uniform(PASSAGE_M + 0.1, 4.0), rng.uniform(4.0, 8.0)
    x_m, thick_m = rng.uniform(-1.5, 1.5), rng.uniform(0.4, 0.8)
    pieces = _across(canvas, x_m - length_m / 2, [(y_m, width_m)])
    for side in (-1.0, 1.0):
        pieces.append(_wall(canvas, x_m, y_m + side * (width_m + thick_m) / 2, length_m, thick_m))
    return pieces


def _pockets(canvas: Canvas) -> list[Obstacle]:
    """Return one dead end between start and goal, or two side by side, open towards the start."""
    rng = canvas.rng
    middle_m = (canvas.ends[0][1] + canvas.ends[1][1]) / 2
    single = rng.random() < 0.6
    rows = [_row(canvas, middle_m - 1, middle_m + 1)] if single else [_row(canvas, -6, -4.5), _row(canvas, 4.5, 6)]
    pieces = []
    for y_m in rows:
        x_m, width_m, depth_m = rng.uniform(0.0, 4.0), rng.uniform(PASSAGE_M + 0.1, 4.6), rng.uniform(2.5, 5.0)
        thick_m = rng.uniform(0.4, 0.8)
        pieces.append(_wall(canvas, x_m, y_m, thick_m, width_m + 2 * thick_m))
        for side in (-1.0, 1.0):
            middle = x_m - (depth_m + thick_m) / 2
            pieces.append(_wall(canvas, middle, y_m + side * (width_m + thick_m) / 2, depth_m + 0.05, thick_m))
    return pieces


def _row(canvas: Canvas, low_m: float, high_m: float) -> float:
    """Return y of the centre of a random row of cells: passages are centred on rows, since the car drives there."""
    centres = [float(y) for y in DEFAULT_GRID.cell_centres()[1] if low_m <= y <= high_m]
    return centres[int(canvas.rng.integers(len(centres)))]


def _across(canvas: Canvas, x_m: float, gaps: list[tuple[float, float]]) -> list[Obstacle]:
    """Return the pieces of a wall across the arena at `x_m`, with gaps `(centre_m, width_m)` from south to north."""
    thick_m = canvas.rng.uniform(0.4, 0.8)
    bounds = [-EDGE_M]
    for y_m, width_m in gaps:
        bounds += [y_m - width_m / 2, y_m + width_m / 2]
    bounds.append(EDGE_M)
    pieces = []
    for low, high in zip(bounds[::2], bounds[1::2], strict=True):
        pieces.append(_wall(canvas, x_m, (low + high) / 2, thick_m, high - low))
    return pieces


def _wall(canvas: Canvas, x_m: float, y_m: float, east_m: float, north_m: float) -> Obstacle:
    """Return a wall from its centre and sides; sides are rounded down, so that no passage becomes narrower."""
    height_m = round(float(canvas.rng.uniform(*WALL_HEIGHTS_M)), 2)
    size_m = (math.floor(east_m * 500) / 500, math.floor(north_m * 500) / 500, height_m)
    return Obstacle("box", round(float(x_m), 4), round(float(y_m), 4), None, size_m)


def street(canvas: Canvas) -> None:
    """Add a street from west to east: buildings behind the pavements, cars along the kerbs, poles and people.

    Raises:
        Redraw: an obstacle is too close to start or goal.
    """
    rng = canvas.rng
    middle_m = (canvas.ends[0][1] + canvas.ends[1][1]) / 2
    kerb_m = rng.uniform(*ROAD_HALF_M)
    for side in (-1.0, 1.0):
        front_m = kerb_m + rng.uniform(1.6, 2.6)
        x_m = -EDGE_M
        while x_m < EDGE_M - 2.0:  # a row of buildings
            length_m, depth_m = rng.uniform(3.0, 8.0), rng.uniform(1.5, 3.0)
            size_m = (round(length_m, 2), round(depth_m, 2), round(rng.uniform(2.2, 6.0), 2))
            centre_y = round(middle_m + side * (front_m + depth_m / 2), 2)
            centre_x = round(min(x_m + length_m / 2, EDGE_M), 2)
            if abs(centre_y) <= EDGE_M:
                canvas.obstacles.append(Obstacle("box", centre_x, centre_y, None, size_m))
            x_m += length_m + (rng.uniform(0.0, 0.1) if rng.random() < 0.6 else rng.uniform(PASSAGE_M, 4.5))
        for x_m in _positions(canvas, -10.0, 4.6, 8.0):  # parked cars
            car_size_m = draw(rng, "car", 0.0, 0.0).size_m
            heading_deg = round(rng.normal(0.0 if side < 0 else 180.0, 2.0), 1)
            position = (round(x_m, 2), round(middle_m + side * (kerb_m - _CAR_FROM_KERB_M), 2))
            canvas.place(Obstacle("car", *position, None, car_size_m, heading_deg), 0.4)
        for x_m in _positions(canvas, -11.0, 3.5, 7.0):  # lamp posts and signs
            radius_m = round(rng.uniform(0.08, 0.25), 2)
            y_m = middle_m + side * (kerb_m + _POLE_BEHIND_KERB_M)
            canvas.place(Obstacle("pole", round(x_m, 2), round(y_m, 2), radius_m), 0.2)
    for _ in range(int(rng.integers(3, 9))):
        y_m = middle_m + rng.choice((-1.0, 1.0)) * rng.uniform(0.5, kerb_m + 1.4)
        radius_m = round(rng.uniform(0.25, 0.35), 2)
        canvas.place(Obstacle("person", round(rng.uniform(-9.5, 9.5), 2), round(y_m, 2), radius_m), 0.3)
    if not all(canvas.clear_of_ends(obstacle) for obstacle in canvas.obstacles):
        raise Redraw


def road_of(scene: Scene) -> Road | None:
    """Return the road of a scene with the layout of a `street`, turned or not; None for every other scene.

    A scene file does not name a road, so it is recognised by the obstacles along it: all poles are in two lines behind
    the kerbs and all cars in two lines in front of them. Scattered obstacles are never placed in such lines.
    """
    poles = [(o.y_m, o.x_m) for o in scene.obstacles if o.kind == "pole"]
    cars = [(o.y_m, o.x_m) for o in scene.obstacles if o.kind == "car"]
    if scene.ground != "asphalt" or not poles or not cars:
        return None
    for along_x, axis in ((True, 0), (False, 1)):
        lines = [pole[axis] for pole in poles]
        middle_m, pole_m = (max(lines) + min(lines)) / 2, (max(lines) - min(lines)) / 2
        half_m = pole_m - _POLE_BEHIND_KERB_M
        if (
            ROAD_HALF_M[0] - _LINE_M <= half_m <= ROAD_HALF_M[1] + _LINE_M
            and all(abs(abs(y_m - middle_m) - pole_m) <= _LINE_M for y_m in lines)
            and all(abs(abs(car[axis] - middle_m) - (half_m - _CAR_FROM_KERB_M)) <= _LINE_M for car in cars)
        ):
            return Road(along_x, middle_m, half_m)
    return None


def _positions(canvas: Canvas, first_m: float, least_m: float, most_m: float) -> list[float]:
    """Return positions along the street in metres, from `first_m` on, at random distances."""
    positions, x_m = [], first_m + canvas.rng.uniform(0.0, 3.0)
    while x_m < -first_m:
        positions.append(x_m)
        x_m += canvas.rng.uniform(least_m, most_m)
    return positions
