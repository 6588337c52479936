"""Simulated physics of one car among the obstacles of a scene, driven action by action along the planning lattice."""

import math
from typing import Any, NamedTuple

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.errors import SceneError
from zsdist.planning.footprint import ADVANCES, CAR_LENGTH_M, CAR_WIDTH_M, TURNS, successor
from zsdist.planning.grid import HEADINGS, Grid
from zsdist.sim.bullet import Client, pybullet
from zsdist.sim.physics.car import GROUND_GROUP, OBSTACLE_GROUP, SKIN_GROUP, WHEEL_GROUP, CarBody, heading_and_speed
from zsdist.sim.physics.collision import NO_BOXES, NO_CIRCLES, box_clearance, touching
from zsdist.sim.physics.controller import Manoeuvre, Rates, steer
from zsdist.sim.scenes.scene import Scene
from zsdist.sim.scenes.walkers import Walker
from zsdist.types import LatticeState, Pose

MOST_STEPS = 80  # most simulation steps of one manoeuvre; the slowest take about half as many
SETTLE_STEPS = 4  # simulation steps in which the car settles on its wheels before an episode
CONTACT_WITHIN_M = 0.15  # with more clearance by the box test, PyBullet is not queried for contacts
ON_LATTICE_M = 0.10  # a start within this distance of a lattice state, and within this angle, is on the lattice
ON_LATTICE_RAD = math.radians(5.0)

_SOLVER_ITERATIONS = 10  # half the time of PyBullet's default of 50, without a difference in driving
_HEIGHT_M = 2.0  # height of every collision shape, also for lower obstacles, which the wheels would hit
_WALL_M = 1.0  # thickness of the arena's walls
_PER_COMPOUND = 16  # PyBullet silently drops further shapes of an array
_MOST_SHAPES = 4096  # PyBullet frees collision shapes only when its client is closed
# By default PyBullet makes articulated bodies without joints; bodies that never move by themselves then take a tenth of
# each simulation step. With this option the car's poses are bit-identical.
_RIGID = {"useMaximalCoordinates": True}
_NOBODY = np.empty((0, 2))
_NOBODY.flags.writeable = False
_UPRIGHT = [0.0, 0.0, 0.0, 1.0]


class DriveResult(NamedTuple):
    """Result of driving one action.

    Attributes:
        pose: true pose of the car at the end.
        sim_steps: number of simulation steps.
        contact: whether the car collided, by the box test on the true pose or by PyBullet's contacts. If the two
            disagree (at about one pose in two thousand), either counts: a car whose box overlaps an obstacle has hit
            it, and a car that the solver pushes off an obstacle no longer drives freely.
        confirmed: whether PyBullet's contacts at this pose agree with the box test.
    """

    pose: Pose
    sim_steps: int
    contact: bool
    confirmed: bool


_CLOSED = "the world is closed; make another one"


class _Closed:
    """Stand-in for the car of a closed world."""

    def __getattr__(self, name: str) -> Any:
        raise RuntimeError(_CLOSED)


class World:
    """Walled arena in a PyBullet client of its own (DIRECT: no window).

    Episodes do not influence one another: the same scene and actions give bit-identical poses after any other episodes.
    So a copy, or a world from a pickle, repeats all calls since the last reset in a client of its own.

    Args:
        grid: planning grid and arena.
        step_s: duration of a simulation step.

    Attributes:
        grid: planning grid and arena.
        step_s: duration of a simulation step, in seconds.
        scene: scene of the last reset; None before the first, and after one that failed.

    Raises:
        SimulationError: PyBullet allows no further client in this process.
    """

    def __init__(self, grid: Grid, step_s: float = 0.05) -> None:
        self.grid = grid
        self.step_s = step_s
        self.scene: Scene | None = None
        self._connection: Client | None = None
        self._car: CarBody | _Closed = _Closed()
        self._calls: list[tuple[str, tuple[Any, ...]]] = []  # those since the last reset, for copies
        self._connect()

    def __getstate__(self) -> dict[str, Any]:
        return {"grid": self.grid, "step_s": self.step_s, "open": self._connection is not None, "calls": self._calls}

    def __setstate__(self, state: dict[str, Any]) -> None:
        World.__init__(self, state["grid"], state["step_s"])
        for method, arguments in state["calls"]:
            getattr(self, method)(*arguments)
        if not state["open"]:
            self.close()

    def close(self) -> None:
        """Close the physics client; the world cannot be used afterwards, and closing again does nothing."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
            self._client = -1  # another world may get the number
            self._car = _Closed()

    @property
    def pose(self) -> Pose:
        """True pose of the car."""
        return self._car.motion().pose

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll (right side down positive) and pitch (nose down positive) of the car in radians."""
        return self._car.tilt()

    @property
    def people(self) -> np.ndarray:
        """Present positions of the walking obstacles, `(W, 2)` float64, metres, in the order of the scene."""
        if not self._walkers:
            return _NOBODY
        return np.array([(walker.x_m, walker.y_m) for walker in self._walkers], dtype=np.float64)

    def reset(self, scene: Scene, start: Pose | None = None) -> int:
        """Set up a scene and the car; if the car starts off the lattice, drive it onto the lattice.

        If there is no room for that, the car stays at its start, and its first action ends on the lattice.

        Args:
            scene: scene to set up. The bodies of the previous scene are kept if its obstacles are equal.
            start: pose of the car; None: the scene's start.

        Returns:
            Number of simulation steps driven to reach the lattice.

        Raises:
            SceneError: an obstacle or a wall stands on the start.
        """
        if self._connection is None:
            raise RuntimeError(_CLOSED)
        self._calls = []
        repeat = ("reset", (scene, start))
        start = scene.start.pose if start is None else start
        self._set_up(scene)
        if touching(start, self._circles, self._boxes, arena_m=self.grid.arena_m):
            self.scene = None
            place = f"({start.x_m:g}, {start.y_m:g})"
            raise SceneError(f"scene {scene.name}: an obstacle or a wall stands on the start {place}")
        self._place(start)
        for _ in range(SETTLE_STEPS):
            pybullet.stepSimulation(physicsClientId=self._client)
        off = self._off_lattice(start, self.grid.pose(self.grid.lattice_state(start)))
        sim_steps = self._drive_onto_lattice(start) if off else 0
        self._calls.append(repeat)
        return sim_steps

    def put(self, pose: Pose) -> None:
        """Put the car at rest at `pose`, even if it overlaps an obstacle."""
        self._calls.append(("put", (pose,)))
        self._place(pose)

    def drive(self, action: int) -> DriveResult:
        """Drive one `Action`, and stop at once at a collision.

        The target is the state to which the action leads from the lattice state nearest to the true pose, so that
        errors do not add up. Instead of an advance that would leave the grid, the car only turns.
        """
        self._calls.append(("drive", (action,)))
        state = self.grid.lattice_state(self.pose)
        end = successor(state, action)
        advance = bool(ADVANCES[action])
        if not self.grid.on_grid(end.ix, end.iy):
            end, advance = LatticeState(state.ix, state.iy, end.heading), False
        return self._carry_out(Manoeuvre(self.grid.pose(end), advance, bool(TURNS[action]), self.step_s))

    def contact(self) -> bool:
        """Return whether the car touches an obstacle at its present pose, by PyBullet's collision detection."""
        self._calls.append(("contact", ()))
        return self._detect_contact()

    def _detect_contact(self) -> bool:
        pybullet.performCollisionDetection(physicsClientId=self._client)
        return self._car.contact()

    def touches(self) -> bool:
        """Return whether the car touches an obstacle at its present pose, by the box test."""
        return touching(self.pose, self._circles, self._boxes, arena_m=self.grid.arena_m)

    def _carry_out(self, manoeuvre: Manoeuvre) -> DriveResult:
        car, client, steps = self._car, self._client, 0
        state, circles, boxes, wall = manoeuvre.state, self._circles, self._boxes, self.grid.arena_m / 2
        while True:
            motion = car.raw_motion()
            heading, room_m, left, right = _control(state, circles, boxes, wall, *motion)
            if steps > 0 and (room_m <= 0.0 or (room_m < CONTACT_WITHIN_M and car.contact())):
                confirmed = self._detect_contact() == (room_m <= 0.0)
                return DriveResult(Pose(motion[0], motion[1], heading), steps, True, confirmed)
            if steps == MOST_STEPS or math.isnan(left):
                return DriveResult(Pose(motion[0], motion[1], heading), steps, False, True)
            car.command(Rates(left, right))
            if self._walkers:
                self._walk(Pose(motion[0], motion[1], heading))
            pybullet.stepSimulation(client)
            steps += 1

    def _walk(self, car: Pose) -> None:
        for walker, row, body in zip(self._walkers, self._walker_rows, self._walker_bodies, strict=True):
            if walker.walk(car, self.step_s):
                self._circles[row, :2] = walker.x_m, walker.y_m
                self._move(body, walker)

    def _place(self, pose: Pose) -> None:
        self._car.place(pose)

    def _off_lattice(self, pose: Pose, target: Pose) -> bool:
        turn = math.remainder(target.heading_rad - pose.heading_rad, math.tau)
        return math.dist(pose[:2], target[:2]) > ON_LATTICE_M or abs(turn) > ON_LATTICE_RAD

    def _drive_onto_lattice(self, start: Pose) -> int:
        for target in self._lattice_nearby(start):
            bearing = math.atan2(target.y_m - start.y_m, target.x_m - start.x_m)
            far = math.dist(start[:2], target[:2]) > ON_LATTICE_M
            if not self._path_is_free(start, target, bearing if far else start.heading_rad):
                continue
            steps = 0
            if far:
                advance = Manoeuvre(target._replace(heading_rad=bearing), True, True, self.step_s)
                steps += self._carry_out(advance).sim_steps
            result = self._carry_out(Manoeuvre(target, False, True, self.step_s))
            if not result.contact:
                return steps + result.sim_steps
            self._place(start)
        return 0

    def _lattice_nearby(self, pose: Pose) -> list[Pose]:
        """Return the poses of the lattice states around `pose`, the nearest first."""
        near = self.grid.lattice_state(pose)
        cells = [(near.ix + dx, near.iy + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        states = [
            LatticeState(ix, iy, (near.heading + turn) % HEADINGS)
            for ix, iy in cells
            if self.grid.on_grid(ix, iy)
            for turn in (-1, 0, 1)
        ]

        def effort(target: Pose) -> float:
            turn = math.remainder(target.heading_rad - pose.heading_rad, math.tau)
            return math.dist(pose[:2], target[:2]) + abs(turn)

        return sorted((self.grid.pose(state) for state in states), key=effort)

    def _path_is_free(self, start: Pose, target: Pose, bearing: float) -> bool:
        """Return whether the car can turn to `bearing`, go straight to `target` and turn to its heading."""
        poses = [start._replace(heading_rad=angle) for angle in _arc(start.heading_rad, bearing)]
        poses += [
            Pose(start.x_m + share * (target.x_m - start.x_m), start.y_m + share * (target.y_m - start.y_m), bearing)
            for share in np.linspace(0.0, 1.0, 20)
        ]
        poses += [target._replace(heading_rad=angle) for angle in _arc(bearing, target.heading_rad)]
        return not any(touching(pose, self._circles, self._boxes, arena_m=self.grid.arena_m) for pose in poses)

    def _connect(self) -> None:
        self.close()
        self._connection = Client()
        self._client = client = self._connection.number
        pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=self.step_s,
            numSolverIterations=_SOLVER_ITERATIONS,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        ground = pybullet.createMultiBody(baseCollisionShapeIndex=plane, **_RIGID, physicsClientId=client)
        pybullet.setCollisionFilterGroupMask(ground, -1, GROUND_GROUP, WHEEL_GROUP, physicsClientId=client)
        pybullet.changeDynamics(ground, -1, lateralFriction=1.0, physicsClientId=client)
        self._car = CarBody(client)
        middle = (self.grid.arena_m + _WALL_M) / 2
        side = self.grid.arena_m + 2 * _WALL_M
        walls = [(x, y, side, _WALL_M, turn) for x, y, turn in _sides(middle)]
        # For a body without a visual shape PyBullet makes a mesh of each collision shape, which takes 0.4 ms each.
        self._visual = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=[0.01] * 3, physicsClientId=client)
        self._shapes = 0
        self._build(NO_CIRCLES, np.array(walls))
        self._standing_bodies: list[int] = []
        self._walkers: list[Walker] = []
        self._walker_rows: list[int] = []
        self._walker_bodies: list[int] = []
        self._circles, self._boxes = NO_CIRCLES, NO_BOXES
        self.scene = None

    def _set_up(self, scene: Scene) -> None:
        """Create the obstacles' bodies, always in the order of the scene, so that repeated drives are bit-identical."""
        if self.scene is None or self.scene.obstacles != scene.obstacles:
            if self._shapes + len(scene.obstacles) > _MOST_SHAPES:
                self._connect()
            for body in self._standing_bodies + self._walker_bodies:
                pybullet.removeBody(body, physicsClientId=self._client)
            self._standing_bodies = self._build(scene.standing_circles(), scene.boxes())
            self._walker_bodies = [
                body
                for walker in scene.walkers()
                for body in self._build(np.array([(0.0, 0.0, walker.radius_m)]), NO_BOXES)
            ]
        self.scene = scene
        self._circles, self._boxes = scene.circles(), scene.boxes()
        round_ones = [obstacle for obstacle in scene.obstacles if obstacle.radius_m is not None]
        self._walker_rows = [row for row, obstacle in enumerate(round_ones) if obstacle.walks]
        self._walkers = [Walker(obstacle) for obstacle in scene.walkers()]
        for walker, body in zip(self._walkers, self._walker_bodies, strict=True):
            self._move(body, walker)

    def _move(self, body: int, walker: Walker) -> None:
        position = [walker.x_m, walker.y_m, 0.0]
        pybullet.resetBasePositionAndOrientation(body, position, _UPRIGHT, physicsClientId=self._client)

    def _build(self, circles: np.ndarray, boxes: np.ndarray) -> list[int]:
        """Return bodies of up to `_PER_COMPOUND` shapes: simulation steps are faster than with one body per shape."""
        shapes = [
            (pybullet.GEOM_CYLINDER, radius, [0.0, 0.0, 0.0], [x, y, _HEIGHT_M / 2], _UPRIGHT)
            for x, y, radius in circles.tolist()
        ]
        for x, y, length, width, heading in boxes.tolist():
            quaternion = [0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)]
            half = [length / 2, width / 2, _HEIGHT_M / 2]
            shapes.append((pybullet.GEOM_BOX, 0.0, half, [x, y, _HEIGHT_M / 2], quaternion))
        bodies = []
        for first in range(0, len(shapes), _PER_COMPOUND):
            chunk = shapes[first : first + _PER_COMPOUND]
            types, radii, halves, positions, quaternions = (list(column) for column in zip(*chunk, strict=True))
            compound = pybullet.createCollisionShapeArray(
                shapeTypes=types,
                radii=radii,
                halfExtents=halves,
                lengths=[_HEIGHT_M] * len(types),
                collisionFramePositions=positions,
                collisionFrameOrientations=quaternions,
                physicsClientId=self._client,
            )
            body = pybullet.createMultiBody(
                baseCollisionShapeIndex=compound,
                baseVisualShapeIndex=self._visual,
                **_RIGID,
                physicsClientId=self._client,
            )
            pybullet.setCollisionFilterGroupMask(body, -1, OBSTACLE_GROUP, SKIN_GROUP, physicsClientId=self._client)
            bodies.append(body)
        self._shapes += len(shapes)
        return bodies


def _arc(begin: float, end: float) -> np.ndarray:
    turn = math.remainder(end - begin, math.tau)
    return begin + np.linspace(0.0, turn, 2 + int(abs(turn) / math.radians(3.0)))


def _sides(middle: float) -> list[tuple[float, float, float]]:
    return [(0.0, middle, 0.0), (0.0, -middle, 0.0), (middle, 0.0, math.pi / 2), (-middle, 0.0, math.pi / 2)]


@compiled()
def _control(
    state: np.ndarray, circles: np.ndarray, boxes: np.ndarray, wall: float, *motion: float
) -> tuple[float, float, float, float]:
    """Return heading (rad), clearance (m), and the next left and right wheel rates (rad/s) of a car in a manoeuvre.

    One compiled call does all of this, since it is made about 20 times an action.

    Args:
        state: state of the `Manoeuvre`; written in place.
        circles: collision circles as in `clearance_m`.
        boxes: collision boxes as in `clearance_m`.
        wall: half the arena's side, in metres.
        *motion: numbers from `CarBody.raw_motion`.
    """
    x_m, y_m = motion[0], motion[1]
    heading, speed_mps, turn_rate = heading_and_speed(*motion)
    room_m = box_clearance(x_m, y_m, heading, CAR_LENGTH_M / 2, CAR_WIDTH_M / 2, circles, boxes, wall)
    left, right = steer(state, x_m, y_m, heading, speed_mps, turn_rate)
    return heading, room_m, left, right
