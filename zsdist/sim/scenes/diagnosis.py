"""Diagnosis of scenes: the way from start to goal, its narrowest place, and why there is none."""

import math
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise

import numpy as np

from zsdist.planning.footprint import CAR_WIDTH_M, MARGIN_M, FootprintTable, successor
from zsdist.planning.forward_search import path_lengths_from
from zsdist.planning.grid import Grid
from zsdist.planning.shortest_path import LatticePath, cost_to_go, goal_mask, length_m, metres_cost, path
from zsdist.sim.physics.collision import clearance_m
from zsdist.sim.scenes.families_layout import PASSAGE_M
from zsdist.sim.scenes.scene import DEFAULT_GRID, Scene
from zsdist.sim.scenes.solvability import SUCCESS_RADIUS_M, footprints
from zsdist.types import LatticeState, Pose

NEEDED_M = CAR_WIDTH_M + 2 * MARGIN_M  # least width of a straight passage along the lattice
_MARGINS_M = (0.05, 0.0, -0.1, -0.2, -0.3, -0.4)  # of ever smaller cars, which find the place that is too narrow
_FARTHEST_M = 25.0  # to which width is measured on each side
_NEAR_M = 0.005
_AROUND_CELLS = 2  # cells around a narrow place in which a smaller car may drive
_PER_MOVE = 4  # places along a move at which the width is measured


@dataclass(frozen=True)
class Narrow:
    """Narrow place of a way.

    Attributes:
        x_m: x of its middle.
        y_m: y of its middle.
        width_m: free width across the way.
        across_rad: direction in which it was measured.
        sides: what stands on either side, as text; one where both are the same.
    """

    x_m: float
    y_m: float
    width_m: float
    across_rad: float
    sides: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.width_m:.2f} m at ({self.x_m:.2f}, {self.y_m:.2f}), {_between(self.sides)}"


@dataclass(frozen=True)
class Diagnosis:
    """Finding about the way of a car through a scene.

    Attributes:
        way: the shortest path to the goal; None if there is none.
        way_m: its length in metres; infinite without one.
        reachable: cells that the car can reach from its start, `[iy, ix]` bool.
        narrow: the narrowest place of the way; without a way, the places that are too narrow.
        near: path of a smaller car through these places; None if no car could pass.
        reason: text that says why there is no way; None if there is one.
    """

    way: LatticePath | None
    way_m: float
    reachable: np.ndarray
    narrow: tuple[Narrow, ...]
    near: LatticePath | None
    reason: str | None


@cache
def _smaller(grid: Grid, margin_m: float) -> FootprintTable:
    return FootprintTable(grid, margin_m)


def diagnose(scene: Scene, grid: Grid = DEFAULT_GRID, success_radius_m: float = SUCCESS_RADIUS_M) -> Diagnosis:
    """Return the way of a scene, or why there is none.

    Walking people are left out, as in `solve`, since they stop for the car.
    """
    costs, goals = metres_cost(grid), goal_mask(grid, scene.goal, success_radius_m)
    occupancy, start = scene.occupancy(grid), grid.lattice_state(scene.start.pose)
    blocked = footprints(grid).blocked(occupancy)
    reachable = np.isfinite(path_lengths_from(blocked, start, costs))
    field = cost_to_go(blocked, goals, costs)
    widths = _Widths(scene, grid)
    made = partial(Diagnosis, None, math.inf, reachable)
    if math.isfinite(field[start.iy, start.ix, start.heading]):
        way = path(field, blocked, start, costs)
        narrowest = min((widths.of_move(*move) for move in pairwise(way.states)), key=_width, default=None)
        narrow: tuple[Narrow, ...] = () if narrowest is None else (narrowest,)
        return Diagnosis(way, length_m(way.states, grid.cell_size_m), reachable, narrow, None, None)
    if blocked[start.iy, start.ix, start.heading].all():
        name, gap_m = widths.nearest(scene.start.x_m, scene.start.y_m)
        return made((), None, f"the car can make no move from its start: {name} is {gap_m:.2f} m from its centre")
    if not (np.isfinite(field) & (field > 0)).any():
        name, gap_m = widths.nearest(*scene.goal)
        return made(
            (), None, f"the car fits nowhere within {success_radius_m:g} m of the goal: {name} is {gap_m:.2f} m from it"
        )
    for margin_m in _MARGINS_M:
        small = _smaller(grid, margin_m).blocked(occupancy)
        field = cost_to_go(small, goals, costs)
        if math.isfinite(field[start.iy, start.ix, start.heading]):
            groups = _too_narrow(path(field, small, start, costs), blocked, widths)
            narrow, near = _needed(groups, blocked, small, goals, start, costs)
            return made(narrow, near, _reason_of(narrow))
    least_m = CAR_WIDTH_M + 2 * _MARGINS_M[-1]
    return made((), None, f"obstacles close it off: no gap of even {least_m:.1f} m leads from the start to the goal")


def _too_narrow(near: LatticePath, blocked: np.ndarray, widths: "_Widths") -> list[tuple[Narrow, list[LatticeState]]]:
    """Return each row of moves that the car itself cannot make: its narrowest place, and its states."""
    groups: list[tuple[Narrow, list[LatticeState]]] = []
    before = False
    for state, action in zip(near.states, near.actions, strict=False):
        is_blocked = bool(blocked[state.iy, state.ix, state.heading, action])
        if is_blocked:
            place = widths.of_move(state, successor(state, action))
            if before:
                place, states = min(place, groups[-1][0], key=_width), [*groups.pop()[1], state]
            else:
                states = [state]
            groups.append((place, states))
        before = is_blocked
    return groups


def _needed(
    groups: list[tuple[Narrow, list[LatticeState]]],
    blocked: np.ndarray,
    small: np.ndarray,
    goals: np.ndarray,
    start: LatticeState,
    costs: np.ndarray,
) -> tuple[tuple[Narrow, ...], LatticePath]:
    """Return the fewest places, narrowest first, where a smaller car is needed, and its way.

    A smaller car drives closer to obstacles than it must. Where the car itself could keep away, nothing is too narrow.

    Args:
        groups: from `_too_narrow`.
        blocked: blocked moves of the car.
        small: blocked moves of the smaller car, fewer.
        goals: cells of the goal.
        start: start of the way.
        costs: costs of actions.
    """
    groups = sorted(groups, key=lambda group: group[0].width_m)
    ys, xs = np.indices(goals.shape)
    widened = np.zeros(goals.shape, bool)
    for count, (_, states) in enumerate(groups, start=1):
        for state in states:
            widened |= (abs(xs - state.ix) <= _AROUND_CELLS) & (abs(ys - state.iy) <= _AROUND_CELLS)
        mixed = np.where(widened[..., None, None], small, blocked)
        field = cost_to_go(mixed, goals, costs)
        if math.isfinite(field[start.iy, start.ix, start.heading]):
            return tuple(place for place, _ in groups[:count]), path(field, mixed, start, costs)
    raise AssertionError("with all its places widened the smaller car has the way that it was found by")


def _reason_of(narrow: tuple[Narrow, ...]) -> str:
    worst = min(narrow, key=_width)
    more = f" (and {len(narrow) - 1} more)" if len(narrow) > 1 else ""
    enough = f"{PASSAGE_M:.1f} m are always enough"
    if worst.width_m < NEEDED_M:
        return f"too narrow: {worst}{more}; the car needs {NEEDED_M:.2f} m, and {enough}"
    return f"too narrow to turn, or not in line with the car's lattice: {worst}{more}; {enough}"


def _between(sides: tuple[str, ...]) -> str:
    return f"between {sides[0]} and {sides[1]}" if len(sides) > 1 else f"within {sides[0]}"


def _width(place: Narrow) -> float:
    return place.width_m


class _Widths:
    """Free widths in a scene without its walking people.

    Args:
        scene: the scene.
        grid: its grid, with the arena's walls.
    """

    def __init__(self, scene: Scene, grid: Grid) -> None:
        self._grid = grid
        self._circles, self._boxes = scene.standing_circles(), scene.boxes()
        standing = [obstacle for obstacle in scene.obstacles if not obstacle.walks]
        self._round = [obstacle for obstacle in standing if obstacle.radius_m is not None]
        self._square = [obstacle for obstacle in standing if obstacle.size_m is not None]

    def of_move(self, state: LatticeState, after: LatticeState) -> Narrow:
        """Return the least width across a move between two states, and what stands there."""
        begin, end = self._grid.pose(state), self._grid.pose(after)
        across = end.heading_rad + math.pi / 2
        places = []
        for share in np.linspace(0.0, 1.0, _PER_MOVE + 1):
            x_m, y_m = begin.x_m + share * (end.x_m - begin.x_m), begin.y_m + share * (end.y_m - begin.y_m)
            left, right = (self._along(x_m, y_m, across + turn) for turn in (0.0, math.pi))
            shift = (left - right) / 2
            middle = (float(x_m + shift * math.cos(across)), float(y_m + shift * math.sin(across)))
            ends = [
                (x_m + reach * math.cos(across + turn), y_m + reach * math.sin(across + turn))
                for reach, turn in ((left, 0.0), (right, math.pi))
            ]
            places.append((left + right, middle, ends))
        width_m, middle, ends = min(places)
        return Narrow(*middle, width_m, across, tuple(dict.fromkeys(self.nearest(*at)[0] for at in ends)))

    def nearest(self, x_m: float, y_m: float) -> tuple[str, float]:
        """Return the name of the obstacle, or wall, nearest to a point, and its distance in metres."""
        point, none = Pose(x_m, y_m, 0.0), np.empty
        found = [("the arena's wall", self._grid.arena_m / 2 - max(abs(x_m), abs(y_m)))]
        for rows, obstacles in ((self._circles, self._round), (self._boxes, self._square)):
            for row, obstacle in zip(rows, obstacles, strict=True):
                circles = row[None] if rows is self._circles else none((0, 3))
                boxes = row[None] if rows is self._boxes else none((0, 5))
                name = f"the {obstacle.kind.replace('_', ' ')} at ({obstacle.x_m:.2f}, {obstacle.y_m:.2f})"
                found.append((name, clearance_m(point, circles, boxes, 0.0, 0.0)))
        return min(found, key=lambda pair: pair[1])

    def _along(self, x_m: float, y_m: float, direction: float) -> float:
        """Return the free distance from a point in a direction, at most `_FARTHEST_M`."""
        reach, cos, sin = 0.0, math.cos(direction), math.sin(direction)
        while reach < _FARTHEST_M:
            at = Pose(x_m + reach * cos, y_m + reach * sin, 0.0)
            free = clearance_m(at, self._circles, self._boxes, 0.0, 0.0, self._grid.arena_m)
            if free < _NEAR_M:
                return reach
            reach += free
        return _FARTHEST_M
