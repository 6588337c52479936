"""Solvability of scenes: the shortest path over (cell, heading) on the true map, with the car's footprint."""

from functools import cache

from zsdist.config import SimConfig
from zsdist.planning.footprint import FootprintTable
from zsdist.planning.grid import Grid
from zsdist.planning.shortest_path import LatticePath, cost_to_go, goal_mask, length_m, metres_cost, path
from zsdist.sim.scenes.scene import DEFAULT_GRID, Scene

SUCCESS_RADIUS_M = SimConfig().success_radius_m


@cache
def footprints(grid: Grid) -> FootprintTable:
    """Return the table of the car's footprints on a grid, computed once per process."""
    return FootprintTable(grid)


def solve(scene: Scene, grid: Grid = DEFAULT_GRID, success_radius_m: float = SUCCESS_RADIUS_M) -> LatticePath | None:
    """Return the shortest path from the lattice state nearest to the start to a cell within the goal's success radius.

    Walking people are left out, since they stop for the car; all standing obstacles count, with the footprint's margin.

    Returns:
        The path, or None if there is none.
    """
    blocked = footprints(grid).blocked(scene.occupancy(grid))
    costs = metres_cost(grid)
    field = cost_to_go(blocked, goal_mask(grid, scene.goal, success_radius_m), costs)
    start = grid.lattice_state(scene.start.pose)
    if field[start.iy, start.ix, start.heading] == float("inf"):
        return None
    return path(field, blocked, start, costs)


def shortest_m(scene: Scene, grid: Grid = DEFAULT_GRID, success_radius_m: float = SUCCESS_RADIUS_M) -> float:
    """Return the length in metres of the path of `solve`; infinite if there is none."""
    shortest = solve(scene, grid, success_radius_m)
    return float("inf") if shortest is None else length_m(shortest.states, grid.cell_size_m)
