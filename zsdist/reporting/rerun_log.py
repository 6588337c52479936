"""Recordings for the Rerun viewer (extra `rerun`): what one car sees, believes and does, on one timeline."""

import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from zsdist.errors import RunError
from zsdist.planning.footprint import CAR_LENGTH_M, CAR_WIDTH_M
from zsdist.reporting.belief_view import CAR, FREE, GOAL, OCCUPIED, PATH, START, SUBGOAL, UNSEEN

LIVE = "live"
VIEWER = "127.0.0.1:9876"  # where a live viewer listens; Rerun's own default is every interface
OBSTACLE_M, CAR_M = 1.0, 0.4  # heights as which obstacles and the car are drawn
TIMELINE = "action"  # number of the decision, over all episodes
_OBSTACLE, _WAY = (160, 120, 90), (120, 190, 120)  # the other colours are those of films
_FAR, _MIDDLE, _NEAR = (190, 215, 240), (86, 140, 220), (20, 60, 140)


@dataclass(frozen=True)
class CarFrame:
    """One decision of a car. Points are `(x_m, y_m)` from the middle of the arena, angles degrees.

    Attributes:
        episode: name of the episode; a new one begins a new scene.
        pose: `(x_m, y_m, heading_deg)` of the car.
        start, goal: ends of the drive.
        circles: `(x_m, y_m, radius_m)` of round obstacles.
        boxes: `(x_m, y_m, length_m, width_m, heading_deg)` of the others.
        path: way driven so far.
        way: way to the goal that the car believes in.
        subgoal: target of the low level; None: there is none.
        picture: `(px, px, 3)` uint8, camera; None: there is none.
        attention: the same picture with a heat map; None: there is none.
        rays: angle from the heading, counter-clockwise, and distances in metres within which free space ends with
            probability 0.1, 0.5 and 0.9.
        belief: `(size, size)` uint8, from the south-western corner: 0 unseen, 1 free, 2 occupied; None: no map.
        values: value of each choice of the high level.
        action: chosen action, and who chose it.
        shield_changed: whether the shield changed it.
    """

    episode: str
    pose: tuple[float, float, float]
    start: Sequence[float]
    goal: Sequence[float]
    circles: Sequence[Sequence[float]]
    boxes: Sequence[Sequence[float]]
    path: Sequence[Sequence[float]] = ()
    way: Sequence[Sequence[float]] = ()
    subgoal: Sequence[float] | None = None
    picture: np.ndarray | None = field(default=None, repr=False)
    attention: np.ndarray | None = field(default=None, repr=False)
    rays: Sequence[tuple[float, float, float, float]] = ()
    belief: np.ndarray | None = field(default=None, repr=False)
    values: Mapping[str, float] = field(default_factory=dict)
    action: str = ""
    shield_changed: bool = False


def require_rerun() -> ModuleType:
    """Return the package `rerun`; raise `RunError` where it is not installed."""
    try:
        return import_module("rerun")
    except ImportError as error:
        raise RunError(
            "--rerun needs the package rerun-sdk, which is not installed; install it (390 MB) with "
            "pip install 'zsdist[rerun]'"
        ) from error


class RerunLog:
    """Recording that a file or a viewer takes up, frame by frame, as a context manager.

    Args:
        target: file to write, or `live` for a viewer on this machine, which is started.

    Raises:
        RunError: Rerun is not installed, or the file cannot be written.
    """

    def __init__(self, target: Path | str) -> None:
        self._rerun: Any = require_rerun()
        self._stream: Any = self._rerun.RecordingStream("zsdist")
        self._count, self._episode, self._shown = 0, "", set[str]()
        if target == LIVE:
            host, _, port = VIEWER.partition(":")
            command = [sys.executable, "-m", "rerun", "--bind", host, "--port", port, "--expect-data-soon"]
            subprocess.Popen(command, start_new_session=True)  # it stays when the recording ends
            self._stream.connect_grpc(f"rerun+http://{VIEWER}/proxy", default_blueprint=self._blueprint())
            return
        try:
            self._stream.save(str(target), default_blueprint=self._blueprint())
        except (OSError, RuntimeError) as error:
            raise RunError(f"--rerun {target} cannot be written: {error}") from error

    def __enter__(self) -> "RerunLog":
        return self

    def __exit__(self, *about: object) -> None:
        self._stream.flush()
        self._stream.disconnect()

    def add(self, frame: CarFrame) -> None:
        """Record a decision; what it does not have vanishes from the view."""
        rr = self._rerun
        self._stream.set_time(TIMELINE, sequence=self._count)
        self._count += 1
        if frame.episode != self._episode:
            self._episode = frame.episode
            self._log("decision", rr.TextLog(f"episode {frame.episode} begins", level="INFO"))
        x, y, heading = frame.pose
        turn = rr.RotationAxisAngle(axis=(0, 0, 1), degrees=heading)
        car = {"centers": [(x, y, CAR_M / 2)], "half_sizes": [(CAR_LENGTH_M / 2, CAR_WIDTH_M / 2, CAR_M / 2)]}
        seen: dict[str, Any] = {
            "scene/round": rr.Cylinders3D(
                centers=[(cx, cy, OBSTACLE_M / 2) for cx, cy, _ in frame.circles],
                radii=[radius for _, _, radius in frame.circles],
                lengths=[OBSTACLE_M] * len(frame.circles),
                colors=_OBSTACLE,
            ),
            "scene/boxes": rr.Boxes3D(
                centers=[(cx, cy, OBSTACLE_M / 2) for cx, cy, *_ in frame.boxes],
                half_sizes=[(length / 2, width / 2, OBSTACLE_M / 2) for _, _, length, width, _ in frame.boxes],
                rotation_axis_angles=[rr.RotationAxisAngle(axis=(0, 0, 1), degrees=box[4]) for box in frame.boxes],
                colors=_OBSTACLE,
            ),
            "scene/car": rr.Boxes3D(**car, rotation_axis_angles=[turn], colors=CAR),
            "scene/start": rr.Points3D([_lifted(frame.start)], radii=0.3, colors=START, labels=["start"]),
            "scene/goal": rr.Points3D([_lifted(frame.goal)], radii=0.4, colors=GOAL, labels=["goal"]),
            "scene/path": rr.LineStrips3D([[_lifted(point) for point in (*frame.path, (x, y))]], colors=PATH),
            "shield/changed": rr.Scalars(float(frame.shield_changed)),
        }
        if frame.way:
            seen["scene/way"] = rr.LineStrips3D([[_lifted(point) for point in frame.way]], colors=_WAY)
        if frame.subgoal is not None:
            seen["scene/subgoal"] = rr.Points3D([_lifted(frame.subgoal)], radii=0.3, colors=SUBGOAL)
        for index, (name, colour) in enumerate((("near", _NEAR), ("median", _MIDDLE), ("far", _FAR)), start=1):
            if frame.rays:
                seen[f"scene/rays/{name}"] = rr.LineStrips3D(_strips(frame, index), colors=colour)
        if frame.picture is not None:
            seen["camera"] = rr.Image(frame.picture).compress(jpeg_quality=88)
        if frame.attention is not None:
            seen["attention"] = rr.Image(frame.attention).compress(jpeg_quality=88)
        if frame.belief is not None:
            colours = np.array([UNSEEN, FREE, OCCUPIED], np.uint8)
            seen["belief"] = rr.Image(colours[frame.belief[::-1]])
        seen |= {f"values/{name}": rr.Scalars(value) for name, value in frame.values.items()}
        changed = ", changed by the shield" if frame.shield_changed else ""
        self._log("decision", rr.TextLog(f"{frame.action}{changed}", level="WARN" if changed else "INFO"))
        for path, shown in seen.items():
            self._log(path, shown)
        for path in self._shown - set(seen):
            self._log(path, rr.Clear(recursive=False))
        self._shown = set(seen)

    def _log(self, path: str, shown: Any) -> None:
        self._stream.log(path, shown)

    def _blueprint(self) -> Any:
        """Return the arrangement of the views."""
        views: Any = import_module("rerun.blueprint")
        pictures = [views.Spatial2DView(origin=name, name=name) for name in ("camera", "attention", "belief")]
        lines = [views.TimeSeriesView(origin=name, name=name) for name in ("values", "shield")]
        told = views.TextLogView(origin="decision", name="decisions")
        scene = views.Spatial3DView(origin="scene", name="scene")
        return views.Blueprint(views.Horizontal(scene, views.Vertical(*pictures), views.Vertical(*lines, told)))


def _lifted(point: Sequence[float]) -> tuple[float, float, float]:
    return float(point[0]), float(point[1]), 0.05


def _strips(frame: CarFrame, index: int) -> list[list[tuple[float, float, float]]]:
    """Return a line along each ray, from the car to a distance."""
    x, y, heading = frame.pose
    strips = []
    for ray in frame.rays:
        angle, reach = math.radians(heading + ray[0]), ray[index]
        strips.append([(x, y, CAR_M), (x + reach * math.cos(angle), y + reach * math.sin(angle), CAR_M)])
    return strips
