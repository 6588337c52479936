"""Share of objects that stay completely unseen while the car approaches them with its belief map.

The car approaches an object of a wilderness scene in a straight line. It takes `OBSERVATIONS` pictures at distances
from `FIRST_M` to `LAST_M` between camera and surface, each a little off the line and turned a little, and updates a
`BeliefMap` as when it drives. The object is unseen if, in the end, no fine cell within `AROUND_M` of the points at
which true rays meet it is believed occupied. Fine cells that another obstacle touches do not count.
"""

import contextlib
import dataclasses
import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from zsdist.common import random_streams
from zsdist.config import CameraConfig, Config
from zsdist.datasets.labelled import camera_angles_rad
from zsdist.errors import RunError
from zsdist.evaluation.statistics import wilson_95
from zsdist.planning.belief import BeliefMap
from zsdist.planning.grid import Grid
from zsdist.sim.camera import make_camera
from zsdist.sim.camera.primitives import ARENA_HALF_M
from zsdist.sim.ground_truth import rays_met
from zsdist.sim.physics.collision import touching
from zsdist.sim.scenes.families import generate
from zsdist.sim.scenes.manifest import OOD_FAMILIES, SPLITS, split_seed
from zsdist.sim.scenes.scene import Obstacle, Scene
from zsdist.types import Pose
from zsdist.vision.visual_act import VisualAct

OBSERVATIONS = 30
FIRST_M, LAST_M = 5.0, 1.2  # first and last distance from the camera to the surface of the object
ASIDE_M = 0.3  # standard deviation of a pose across the line
TURNED_RAD = 0.15  # standard deviation of a pose's heading
AROUND_M = 0.4
_TRIES = 200  # most approaches drawn in a scene before the next scene is drawn
_GOAL_M = 8.0  # distance of a goal straight ahead, which has no effect on the map


@dataclasses.dataclass(frozen=True)
class Approach:
    """Poses from which the obstacle `index` of a scene is observed."""

    scene: Scene
    index: int
    poses: tuple[Pose, ...]


def approach(number: int, seed: int, camera: CameraConfig) -> Approach:
    """Return approach `number` of a seed, independent of the others; the car touches nothing in any of its poses."""
    rng, angles_rad = random_streams.check_approach(seed, number), camera_angles_rad(camera)
    for family in itertools.islice(itertools.cycle(OOD_FAMILIES), number % len(OOD_FAMILIES), None):
        scene = generate(family, split_seed("test", int(rng.integers(len(SPLITS["test"])))))
        circles, boxes = scene.circles(), scene.boxes()
        for _ in range(_TRIES if scene.obstacles else 0):
            index = int(rng.integers(len(scene.obstacles)))
            poses = _poses(scene.obstacles[index], camera.forward_m, rng)
            if any(touching(pose, circles, boxes, arena_m=2 * ARENA_HALF_M) for pose in poses):
                continue
            if (rays_met(scene, poses[-1], camera, angles_rad).obstacle == obstacle_number(scene, index)).sum() >= 2:
                return Approach(scene, index, poses)
    raise AssertionError("the cycle of families never ends")


def drive_up(model: VisualAct, drive: Approach, config: Config) -> bool:
    """Return whether the belief map shows some part of the object after all pictures of an approach."""
    with contextlib.closing(make_camera(config.camera)) as camera:
        images = np.stack([camera.render(drive.scene, pose) for pose in drive.poses])
    ahead = np.zeros(len(images), np.float32)
    belief = BeliefMap(Grid.from_config(config.grid))
    for pose, view in zip(drive.poses, model(images, ahead, ahead + _GOAL_M), strict=True):
        belief.update(pose, view, config.camera.forward_m)
    return bool((belief.occupied() & visible_side(drive, belief.grid, config.camera)).any())


def visible_side(drive: Approach, grid: Grid, camera: CameraConfig) -> np.ndarray:
    """Return the fine cells at the object's visible surface, `(fine_size, fine_size)` bool, without other obstacles."""
    angles_rad = camera_angles_rad(camera)
    wanted, (xs, ys) = obstacle_number(drive.scene, drive.index), grid.fine_centres()
    visible = np.zeros((grid.fine_size, grid.fine_size), bool)
    for pose in drive.poses:
        rays = rays_met(drive.scene, pose, camera, angles_rad)
        met = rays.obstacle == wanted
        distance = rays.distance_m[met]
        heading = pose.heading_rad + angles_rad[met]
        points_x = pose.x_m + camera.forward_m * math.cos(pose.heading_rad) + distance * np.cos(heading)
        points_y = pose.y_m + camera.forward_m * math.sin(pose.heading_rad) + distance * np.sin(heading)
        for x_m, y_m in zip(points_x, points_y, strict=True):
            visible |= (xs[None] - x_m) ** 2 + (ys[:, None] - y_m) ** 2 <= AROUND_M**2
    standing = tuple(
        dataclasses.replace(other, path=(), speed_mps=0.0)  # people stand at their first position in these pictures
        for number, other in enumerate(drive.scene.obstacles)
        if number != drive.index
    )
    return visible & ~dataclasses.replace(drive.scene, obstacles=standing).occupancy(grid)


def obstacle_number(scene: Scene, index: int) -> int:
    """Return the number that `raycast.ray_distances` gives to obstacle `index` of a scene: round ones come first."""
    is_round = [obstacle.radius_m is not None for obstacle in scene.obstacles]
    same = sum(other == is_round[index] for other in is_round[:index])
    return same if is_round[index] else sum(is_round) + same


def measure(
    model: VisualAct, config: Config, count: int, seed: int, file: Path | None, log: Callable[[str], None]
) -> dict[str, Any]:
    """Return the share of objects that stay unseen, with Wilson's interval.

    Args:
        model: model that makes the predictions.
        config: configuration with camera and grid.
        count: number of objects that the car approaches.
        seed: seed of scenes and approaches.
        file: file for one JSON line per object; objects that it already has are not measured again. None: no file.
        log: function that prints a line of progress.

    Raises:
        RunError: the file cannot be read or written, is damaged, or belongs to other weights, settings or seed.
    """
    identity = {
        "seed": seed,
        "weights_sha256": model.weights_sha256,
        "camera": config.camera.back_end,
    }
    done = [] if file is None else _resume(file, identity)
    for number in range(len(done), count):
        drive = approach(number, seed, config.camera)
        kind = drive.scene.obstacles[drive.index].kind
        line = {"object": number, "scene": drive.scene.name, "kind": kind, "seen": drive_up(model, drive, config)}
        done.append(line | identity)
        if file is not None:
            _append(file, done[-1])
        if (number + 1) % 20 == 0 or number + 1 == count:
            log(f"objects driven up to: {number + 1} of {count}, unseen {sum(not each['seen'] for each in done)}")
    return summary(done[:count])


def summary(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of all objects, and of each kind."""
    unseen = sum(not line["seen"] for line in lines)
    kinds = sorted({line["kind"] for line in lines})
    return {
        "objects": len(lines),
        "unseen": unseen,
        "share": unseen / len(lines),
        "confidence_95": list(wilson_95(unseen, len(lines))),
        "looks": OBSERVATIONS,
        "kinds": {
            kind: {
                "objects": sum(line["kind"] == kind for line in lines),
                "unseen": sum(line["kind"] == kind and not line["seen"] for line in lines),
            }
            for kind in kinds
        },
    }


def _poses(obstacle: Obstacle, forward_m: float, rng: np.random.Generator) -> tuple[Pose, ...]:
    """Return poses on a line towards an obstacle from a random side; they may touch other obstacles."""
    away = rng.uniform(-math.pi, math.pi)
    facing = away + math.pi
    reach = _reach_m(obstacle, away)
    poses = []
    for distance in np.linspace(FIRST_M, LAST_M, OBSERVATIONS):
        centre, aside = reach + distance + forward_m, rng.normal(0, ASIDE_M)
        poses.append(
            Pose(
                obstacle.x_m + centre * math.cos(away) - aside * math.sin(away),
                obstacle.y_m + centre * math.sin(away) + aside * math.cos(away),
                math.remainder(facing + rng.normal(0, TURNED_RAD), math.tau),
            )
        )
    return tuple(poses)


def _reach_m(obstacle: Obstacle, direction_rad: float) -> float:
    """Return the distance in metres from the centre of an obstacle to its surface in a direction."""
    if obstacle.size_m is None:
        assert obstacle.radius_m is not None, "an obstacle has a size or a radius"
        return obstacle.radius_m
    side = direction_rad - math.radians(obstacle.heading_deg)
    length, width, _ = obstacle.size_m
    return min(length / 2 / max(abs(math.cos(side)), 1e-9), width / 2 / max(abs(math.sin(side)), 1e-9))


def _resume(file: Path, identity: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the lines of a file; raise `RunError` unless they belong to this measurement."""
    if not file.exists():
        return []
    try:
        lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        wrong = [key for line in lines for key in identity if line[key] != identity[key]]
        _ = [(line["object"], line["seen"], line["kind"]) for line in lines]
    except OSError as error:
        raise RunError(f"--objects-file {file} cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(f"--objects-file {file} is damaged: {error}; allowed is an intact or a new file") from error
    if wrong:
        raise RunError(
            f"--objects-file {file} is of another {wrong[0]}; allowed is {identity[wrong[0]]!r}, or a new file"
        )
    if [line["object"] for line in lines] != list(range(len(lines))):
        raise RunError(
            f"--objects-file {file} lacks objects between its first and last; allowed is an intact or a new file"
        )
    return lines


def _append(file: Path, line: dict[str, Any]) -> None:
    try:
        with file.open("a", encoding="utf-8") as out:
            out.write(json.dumps(line) + "\n")
    except OSError as error:
        raise RunError(f"--objects-file {file} cannot be written: {error.strerror or error}") from error
