"""Kinematic car that each action moves exactly to its target: a reference for the simulated car."""

import math

import numpy as np

from zsdist.config import Config
from zsdist.planning.grid import Grid
from zsdist.sim.env import CarNavigation
from zsdist.sim.physics.collision import touching
from zsdist.sim.physics.controller import Manoeuvre
from zsdist.sim.physics.world import DriveResult, World
from zsdist.types import Pose

STEPS = 12  # simulation steps of a turn, and of an advance: about as many as the simulated car takes


class KinematicWorld(World):
    """World in which the car is moved exactly from pose to pose, and only the box test finds collisions."""

    def _carry_out(self, manoeuvre: Manoeuvre) -> DriveResult:
        start, target = self.pose, manoeuvre.target
        poses = [*_turn(start, target), *_advance(start, target)]
        for step, pose in enumerate(poses, 1):
            self._walk(pose)
            self._place(pose)
            if touching(pose, self._circles, self._boxes, arena_m=self.grid.arena_m):
                return DriveResult(pose, step, True, True)
        return DriveResult(target, len(poses), False, True)


def make_env(config: Config, images: bool = True, exact: bool = False) -> CarNavigation:
    """Return the environment with the simulated car, or with the kinematic one if `exact`."""
    env = CarNavigation(config=config, images=images)
    if exact:
        env.world.close()
        env.world = KinematicWorld(Grid.from_config(config.grid), config.sim.step_s)
    return env


def _turn(start: Pose, target: Pose) -> list[Pose]:
    turn = math.remainder(target.heading_rad - start.heading_rad, math.tau)
    if abs(turn) < 1e-3:
        return []
    return [start._replace(heading_rad=start.heading_rad + share * turn) for share in _shares()]


def _advance(start: Pose, target: Pose) -> list[Pose]:
    east, north = target.x_m - start.x_m, target.y_m - start.y_m
    if math.hypot(east, north) < 1e-3:
        return []
    return [target._replace(x_m=start.x_m + share * east, y_m=start.y_m + share * north) for share in _shares()]


def _shares() -> np.ndarray:
    return np.linspace(0.0, 1.0, STEPS + 1)[1:]
