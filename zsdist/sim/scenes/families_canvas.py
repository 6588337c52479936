"""Scene under construction: obstacles are placed at a distance from one another and from start and goal."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from zsdist.sim.physics.collision import clearance_m
from zsdist.sim.scenes.kinds import KINDS
from zsdist.sim.scenes.scene import DEFAULT_GRID, Obstacle, Scene, Start
from zsdist.types import LatticeState, Pose

START_CLEARANCE_M = 1.5  # least distance of start and goal from every surface; this disc is known to be free
SCATTER_M = 9.6  # greatest distance of a scattered obstacle's centre from either axis
TRIES = 80

# Least and greatest radius of each round kind, in metres; trees as in Table 1 of the paper.
RADII_M = {
    "tree": (1.0, 1.0),
    "person": (0.3, 0.3),
    "sand_pile": (0.8, 1.4),
    "rock": (0.6, 1.3),
    "bush": (0.5, 1.1),
    "pole": (0.12, 0.25),
}
# Least and greatest length, width and height of the other kinds, in metres.
SIZES_M = {
    "box": ((1.0, 4.0), (0.5, 2.0), (1.6, 2.6)),
    "car": ((3.8, 4.8), (1.7, 1.95), (1.4, 1.6)),
}


class Redraw(Exception):  # noqa: N818 -- no error: the scene is drawn again
    """Signal that the scene under construction is impossible and must be drawn again."""


@dataclass
class Canvas:
    """Scene under construction: start, goal and the obstacles placed so far.

    Attributes:
        rng: source of the scene's random numbers.
        start: lattice state in which the car starts.
        goal: cell `(ix, iy)` of the goal.
        obstacles: obstacles placed so far.
    """

    rng: np.random.Generator
    start: LatticeState
    goal: tuple[int, int]
    obstacles: list[Obstacle] = field(default_factory=list)

    @property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Start and goal as points `(x_m, y_m)`."""
        return DEFAULT_GRID.centre(self.start.ix, self.start.iy), DEFAULT_GRID.centre(*self.goal)

    def scene(self, name: str, ground: str) -> Scene:
        """Return the scene with the obstacles placed so far."""
        (x_m, y_m), goal = self.ends
        return Scene(name, ground, Start(x_m, y_m, 45.0 * self.start.heading), goal, tuple(self.obstacles))

    def gap_m(self, obstacle: Obstacle, others: list[Obstacle]) -> float:
        """Return the distance in metres from an obstacle's surface to the nearest other; 0 or less: they overlap."""
        rest = Scene("", "", Start(0.0, 0.0, 0.0), (0.0, 0.0), tuple(others))
        circles, boxes = rest.circles(), rest.boxes()
        length_m, width_m = obstacle.size_m[:2] if obstacle.size_m else (0.0, 0.0)
        pose = Pose(obstacle.x_m, obstacle.y_m, math.radians(obstacle.heading_deg))
        return clearance_m(pose, circles, boxes, length_m, width_m) - (obstacle.radius_m or 0.0)

    def clear_of_ends(self, obstacle: Obstacle) -> bool:
        """Return whether start and goal are `START_CLEARANCE_M` or more away from an obstacle's surface."""
        points = [Obstacle("person", x_m, y_m, 0.0) for x_m, y_m in self.ends]
        return self.gap_m(obstacle, points) >= START_CLEARANCE_M

    def place(self, obstacle: Obstacle, gap_m: float) -> bool:
        """Add an obstacle if it is clear of start and goal and `gap_m` from others; return whether it was added."""
        if not self.clear_of_ends(obstacle) or self.gap_m(obstacle, self.obstacles) < gap_m:
            return False
        self.obstacles.append(obstacle)
        return True

    def scatter(
        self,
        count: int,
        kinds: dict[str, float],
        gap_m: float = 0.3,
        scale: float = 1.0,
        centre: Sequence[float] = (0.0, 0.0),
        spread_m: float = SCATTER_M,
    ) -> None:
        """Add obstacles of random kind and size, uniformly over a square.

        Args:
            count: number of obstacles.
            kinds: weight of each kind.
            gap_m: least distance between surfaces.
            scale: factor by which the radii of round obstacles are multiplied.
            centre: centre of the square `(x_m, y_m)`.
            spread_m: half the side of the square.

        Raises:
            Redraw: there is no room for all of them.
        """
        names, weights = list(kinds), np.array(list(kinds.values()))
        for _ in range(count):
            kind = names[int(self.rng.choice(len(names), p=weights / weights.sum()))]
            for _ in range(TRIES):
                x_m, y_m = (round(float(v), 2) for v in np.asarray(centre) + self.rng.uniform(-spread_m, spread_m, 2))
                inside = max(abs(x_m), abs(y_m)) <= SCATTER_M
                if inside and self.place(draw(self.rng, kind, x_m, y_m, scale), gap_m):
                    break
            else:
                raise Redraw

    def walkers(self, count: int) -> None:
        """Add walking people whose whole path is clear of start, goal and standing obstacles.

        Raises:
            Redraw: there is no room for all of them.
        """
        standing = list(self.obstacles)
        for _ in range(count):
            for _ in range(TRIES):
                person = self._walker()
                if all(self.clear_of_ends(p) and self.gap_m(p, standing) >= 0.1 for p in _along(person)):
                    self.obstacles.append(person)
                    break
            else:
                raise Redraw

    def _walker(self) -> Obstacle:
        points = [self.rng.uniform(-9.0, 9.0, 2)]
        for _ in range(int(self.rng.integers(1, 3))):
            angle, length = self.rng.uniform(0.0, math.tau), self.rng.uniform(2.5, 5.5)
            points.append(np.clip(points[-1] + length * np.array([math.cos(angle), math.sin(angle)]), -9.5, 9.5))
        path = tuple((round(float(x), 2), round(float(y), 2)) for x, y in points)
        speed_mps = round(float(self.rng.uniform(0.4, 1.2)), 2)
        return Obstacle("person", *path[0], KINDS["person"].default_radius_m, path=path, speed_mps=speed_mps)


def draw(rng: np.random.Generator, kind: str, x_m: float, y_m: float, scale: float = 1.0) -> Obstacle:
    """Return an obstacle of a kind at a position, with a random size; boxes and cars get a random heading too."""
    if kind in RADII_M:
        return Obstacle(kind, x_m, y_m, round(float(rng.uniform(*RADII_M[kind])) * scale, 2))
    length_m, width_m, height_m = (round(float(rng.uniform(*limits)), 2) for limits in SIZES_M[kind])
    size_m = (length_m, width_m, height_m)
    return Obstacle(kind, x_m, y_m, None, size_m, round(float(rng.uniform(-180.0, 180.0)), 1))


def _along(person: Obstacle) -> list[Obstacle]:
    """Return copies of a person as standing obstacles along its path, a quarter of a metre apart."""
    positions = []
    for (x0, y0), (x1, y1) in zip(person.path, person.path[1:], strict=False):
        count = max(math.ceil(math.hypot(x1 - x0, y1 - y0) / 0.25), 1)
        positions += [(x0 + (x1 - x0) * i / count, y0 + (y1 - y0) * i / count) for i in range(count + 1)]
    return [Obstacle("person", x_m, y_m, person.radius_m) for x_m, y_m in positions]


def turned(scene: Scene, quarters: int) -> Scene:
    """Return the scene turned about the origin by quarters of a turn, counter-clockwise; cells map onto cells."""

    def point(x_m: float, y_m: float) -> tuple[float, float]:
        for _ in range(quarters % 4):
            x_m, y_m = 0.0 - y_m, x_m
        return x_m, y_m

    def obstacle(old: Obstacle) -> Obstacle:
        heading_deg = (old.heading_deg + 90.0 * quarters) % 360.0 if old.size_m else old.heading_deg
        path = tuple(point(*position) for position in old.path)
        return Obstacle(old.kind, *point(old.x_m, old.y_m), old.radius_m, old.size_m, heading_deg, path, old.speed_mps)

    start = Start(*point(scene.start.x_m, scene.start.y_m), (scene.start.heading_deg + 90.0 * quarters) % 360.0)
    return Scene(scene.name, scene.ground, start, point(*scene.goal), tuple(map(obstacle, scene.obstacles)))
