"""Scenes as plain data, and scene files: YAML, metres, arena centre at the origin, x east, y north."""

import hashlib
import json
import math
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from reprlib import repr as show
from typing import Any

import numpy as np
import yaml

from zsdist.common import folders, strict_yaml, values
from zsdist.config import GridConfig
from zsdist.errors import SceneError
from zsdist.planning.grid import Grid
from zsdist.sim.physics.collision import clearance_m, rasterise
from zsdist.sim.scenes.kinds import GROUNDS, KINDS
from zsdist.types import Pose

DEFAULT_GRID = Grid.from_config(GridConfig())
MAX_OBSTACLES = 500
MAX_RADIUS_M = 10.0
MAX_SIDE_M = 40.0  # longer than the arena's diagonal
MAX_SPEED_MPS = 10.0
MAX_NUMBER = 1e4  # greatest size of coordinates and headings; `check` refuses positions outside the arena
MAX_FILE_BYTES = 2**20


@dataclass(frozen=True)
class Start:
    """Start of the car: `x_m`, `y_m`, and `heading_deg` counter-clockwise from east."""

    x_m: float
    y_m: float
    heading_deg: float

    @property
    def pose(self) -> Pose:
        """Start as a pose, with a heading in radians within (-pi, pi]."""
        return Pose(self.x_m, self.y_m, math.pi - (math.pi - math.radians(self.heading_deg)) % math.tau)


@dataclass(frozen=True)
class Obstacle:
    """Obstacle of a scene.

    Attributes:
        kind: name of its kind, a key of `KINDS`.
        x_m: x of its centre at the start of the episode.
        y_m: y of its centre at the start of the episode.
        radius_m: radius of round kinds; None for boxes and cars.
        size_m: `(length, width, height)` of boxes and cars in metres, length along their heading; None for round kinds.
        heading_deg: heading of boxes and cars, counter-clockwise from east.
        path: points `(x_m, y_m)` along which a person walks back and forth, the first its centre; empty: it stands.
        speed_mps: walking speed in metres per second.
    """

    kind: str
    x_m: float
    y_m: float
    radius_m: float | None = None
    size_m: tuple[float, float, float] | None = None
    heading_deg: float = 0.0
    path: tuple[tuple[float, float], ...] = ()
    speed_mps: float = 0.0

    @property
    def walks(self) -> bool:
        """True if the obstacle has a path; only such obstacles move."""
        return bool(self.path)

    @property
    def height_m(self) -> float:
        """Height of the obstacle's body, in metres."""
        return KINDS[self.kind].height_m if self.size_m is None else self.size_m[2]


@dataclass(frozen=True)
class Scene:
    """Scene: a start, a goal and the obstacles between them.

    Attributes:
        name: name of the scene in results.
        ground: name of the ground, a key of `GROUNDS`.
        start: start of the car.
        goal: position of the goal, `(x_m, y_m)`.
        obstacles: obstacles in the order of the file.
    """

    name: str
    ground: str
    start: Start
    goal: tuple[float, float]
    obstacles: tuple[Obstacle, ...]

    def walkers(self) -> tuple[Obstacle, ...]:
        """Return the obstacles with a path, in order; `people` arrays have a row for each."""
        return tuple(obstacle for obstacle in self.obstacles if obstacle.walks)

    def circles(self, people: np.ndarray | None = None) -> np.ndarray:
        """Return the collision circles `(N, 3)` of round obstacles in order: x, y, radius in metres.

        Args:
            people: `(W, 2)`, present positions of the walking obstacles; None: their start positions.
        """
        rows, walker = [], 0
        for obstacle in self.obstacles:
            if obstacle.radius_m is None:
                continue
            x_m, y_m = obstacle.x_m, obstacle.y_m
            if obstacle.walks:
                if people is not None:
                    x_m, y_m = people[walker]
                walker += 1
            rows.append((x_m, y_m, obstacle.radius_m))
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    def standing_circles(self) -> np.ndarray:
        """Return the collision circles of round obstacles that do not walk, `(N, 3)`."""
        rows = [(o.x_m, o.y_m, o.radius_m) for o in self.obstacles if o.radius_m is not None and not o.walks]
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    def boxes(self) -> np.ndarray:
        """Return the collision boxes `(M, 5)`: x, y, length, width (m), heading (rad); without the arena's walls."""
        rows = [
            (o.x_m, o.y_m, o.size_m[0], o.size_m[1], math.radians(o.heading_deg))
            for o in self.obstacles
            if o.size_m is not None
        ]
        return np.array(rows, dtype=np.float64).reshape(-1, 5)

    def occupancy(self, grid: Grid) -> np.ndarray:
        """Return the true occupancy `[iy, ix]` `(fine_size, fine_size)` bool: fine cells touched by standing obstacles.

        Walking people are left out: they stop for the car and never block a path permanently.
        """
        return rasterise(self.standing_circles(), self.boxes(), grid)

    def hash(self) -> str:
        """Return the hash of everything except the name, 16 hexadecimal digits."""
        content = (self.ground, _fields(self.start), self.goal, [_fields(obstacle) for obstacle in self.obstacles])
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


def _fields(item: Start | Obstacle) -> list:
    return list(vars(item).values())


def check(scene: Scene, grid: Grid = DEFAULT_GRID) -> None:
    """Check that a scene fits into the arena.

    Raises:
        SceneError: the start or the goal is off the planning grid, an obstacle's centre or path is outside the arena,
            or an obstacle overlaps the car's start or covers the goal.
    """
    half = grid.arena_m / 2
    for name, x_m, y_m in (("start", scene.start.x_m, scene.start.y_m), ("goal", *scene.goal)):
        if not grid.contains(x_m, y_m):
            side = grid.side_m / 2
            raise SceneError(f"{name} ({x_m:g}, {y_m:g}) is outside the grid; allowed is -{side:g} to below {side:g} m")
    goal = Pose(*scene.goal, 0.0)
    for index, obstacle in enumerate(scene.obstacles):
        label = f"obstacles[{index}], {obstacle.kind} at ({obstacle.x_m:g}, {obstacle.y_m:g}),"
        for x_m, y_m in ((obstacle.x_m, obstacle.y_m), *obstacle.path):
            if max(abs(x_m), abs(y_m)) > half:
                point = f"point ({x_m:g}, {y_m:g})"
                raise SceneError(f"{label} {point} is outside the arena; allowed is -{half:g} to {half:g} m")
        alone = Scene("", scene.ground, scene.start, scene.goal, (obstacle,))
        circles, boxes = alone.circles(), alone.boxes()
        if clearance_m(scene.start.pose, circles, boxes) <= 0:
            raise SceneError(f"{label} stands on the start; move one of the two")
        if not obstacle.walks and clearance_m(goal, circles, boxes, length_m=0.0, width_m=0.0) <= 0:
            raise SceneError(f"{label} covers the goal; move one of the two")


def parse(tree: Any, grid: Grid = DEFAULT_GRID) -> Scene:
    """Return the scene of a mapping with the content of a scene file; raise `SceneError` if it is invalid."""
    scene = _scene(tree)
    check(scene, grid)
    return scene


def read(path: str | Path, grid: Grid = DEFAULT_GRID) -> Scene:
    """Return the scene of a YAML file, fully checked.

    Raises:
        SceneError: the file is unreadable or invalid; the message is one line with the file's name and the reason.
    """
    try:
        if Path(path).stat().st_size > MAX_FILE_BYTES:
            raise SceneError(f"file is larger than the {MAX_FILE_BYTES} bytes allowed")
        scene = parse(strict_yaml.load(Path(path).read_text(encoding="utf-8")), grid)
    except OSError as error:
        raise SceneError(f"scene file {path}: {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: not UTF-8
        raise SceneError(f"scene file {path} is not valid YAML: {' '.join(str(error).split())}") from error
    except SceneError as error:
        raise SceneError(f"scene file {path}: {error}") from error
    return scene


def read_folder(folder: str | Path, grid: Grid = DEFAULT_GRID) -> list[Scene]:
    """Return the scenes of the `*.yaml` and `*.yml` files of a folder, ordered by file name, without hidden files.

    Raises:
        SceneError: there is no such folder, it has no scene file, or one of its files is invalid.
    """
    if not Path(folder).is_dir():
        raise SceneError(f"scene folder {folder} does not exist or is not a folder")
    return [read(path, grid) for path in files(folder)]


def files(path: str | Path) -> list[Path]:
    """Return the scene files of a folder, as `read_folder` takes them, or the path of one file as a list.

    Raises:
        SceneError: there is no such path, or the folder has no scene file.
    """
    path = Path(path)
    if not path.is_dir():
        if not path.exists():
            raise SceneError(f"{path} does not exist; allowed is a scene file, or a folder of them")
        return [path]
    paths = [file for file in folders.visible(path) if file.suffix in (".yaml", ".yml") and file.is_file()]
    if not paths:
        raise SceneError(f"scene folder {path} has no scene file; allowed are files named *.yaml or *.yml")
    return paths


def write(scene: Scene, path: str | Path, comment: str = "") -> None:
    """Write a scene as a file from which `read` returns an equal scene; a comment becomes its first line."""
    Path(path).write_text(content_of(scene, comment), encoding="utf-8")


def content_of(scene: Scene, comment: str = "") -> str:
    """Return the content of the file that `write` makes."""
    head = {
        "version": 1,
        "name": scene.name,
        "ground": scene.ground,
        "start": {"x": scene.start.x_m, "y": scene.start.y_m, "heading_deg": scene.start.heading_deg},
        "goal": {"x": scene.goal[0], "y": scene.goal[1]},
    }
    lines = [f"# {comment}"] if comment else []
    lines += [f"{key}: {_flow(value)}" for key, value in head.items()]
    lines.append("obstacles:" if scene.obstacles else "obstacles: []")
    lines += [f"  - {_flow(_entry(obstacle))}" for obstacle in scene.obstacles]
    return "\n".join(lines) + "\n"


def _entry(obstacle: Obstacle) -> dict[str, Any]:
    entry: dict[str, Any] = {"kind": obstacle.kind, "x": obstacle.x_m, "y": obstacle.y_m}
    if obstacle.size_m is None:
        entry["radius_m"] = obstacle.radius_m
    else:
        entry |= {"size_m": list(obstacle.size_m), "heading_deg": obstacle.heading_deg}
    if obstacle.walks:
        entry |= {"path": [list(point) for point in obstacle.path], "speed_mps": obstacle.speed_mps}
    return entry


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    text = yaml.safe_dump(value, sort_keys=False, default_flow_style=True, width=math.inf, allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...")


def _scene(tree: Any) -> Scene:
    if isinstance(tree, dict) and {"image", "resolution"} <= set(tree):
        raise SceneError("this is a map of Nav2, not a scene; `python -m zsdist.scenes from-map` makes scenes of it")
    _keys(tree, "the file", ("version", "name", "ground", "start", "goal", "obstacles"))
    if tree["version"] not in ("1", 1) or isinstance(tree["version"], bool):
        raise SceneError(f"version is {show(tree['version'])}; allowed is 1")
    name = tree["name"]
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w. -]{0,99}", name):
        raise SceneError(f"name is {show(name)}; allowed are up to 100 letters, digits, spaces, '_', '.' and '-'")
    ground = _one_of(tree["ground"], "ground", GROUNDS)
    _keys(tree["start"], "start", ("x", "y", "heading_deg"))
    _keys(tree["goal"], "goal", ("x", "y"))
    start = Start(*(_number(tree["start"][key], f"start.{key}") for key in ("x", "y", "heading_deg")))
    goal = (_number(tree["goal"]["x"], "goal.x"), _number(tree["goal"]["y"], "goal.y"))
    entries = tree["obstacles"]
    if not isinstance(entries, list) or len(entries) > MAX_OBSTACLES:
        found = f"{len(entries)} entries" if isinstance(entries, list) else show(entries)
        raise SceneError(f"obstacles is {found}; allowed is a list of up to {MAX_OBSTACLES}")
    obstacles = tuple(_obstacle(entry, f"obstacles[{index}]") for index, entry in enumerate(entries))
    return Scene(str(name), ground, start, goal, obstacles)


def _obstacle(entry: Any, label: str) -> Obstacle:
    if not isinstance(entry, dict) or "kind" not in entry:
        raise SceneError(f"{label} is {show(entry)}; allowed is a mapping with a kind")
    kind = _one_of(entry["kind"], f"{label}.kind", KINDS)
    radius_m, size_m = None, None
    if KINDS[kind].round:
        walks = KINDS[kind].dynamic and ("path" in entry or "speed_mps" in entry)
        _keys(entry, f"{label} ({kind})", ("kind", "x", "y", *(("path", "speed_mps") if walks else ())), ("radius_m",))
        default = KINDS[kind].default_radius_m
        radius_m = _number(entry.get("radius_m", default), f"{label}.radius_m", above=0.0, most=MAX_RADIUS_M)
    else:
        walks = False
        _keys(entry, f"{label} ({kind})", ("kind", "x", "y", "size_m"), ("heading_deg",))
        size_m = _numbers(entry["size_m"], f"{label}.size_m", 3, above=0.0, most=MAX_SIDE_M)
    x_m, y_m = _number(entry["x"], f"{label}.x"), _number(entry["y"], f"{label}.y")
    heading_deg = _number(entry.get("heading_deg", 0.0), f"{label}.heading_deg")
    if not walks:
        return Obstacle(kind, x_m, y_m, radius_m, size_m, heading_deg)
    path = _path(entry["path"], f"{label}.path", (x_m, y_m))
    speed_mps = _number(entry["speed_mps"], f"{label}.speed_mps", above=0.0, most=MAX_SPEED_MPS)
    return Obstacle(kind, x_m, y_m, radius_m, size_m, heading_deg, path, speed_mps)


def _path(value: Any, label: str, centre: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    if not isinstance(value, list) or len(value) < 2:
        raise SceneError(f"{label} is {show(value)}; allowed is a list of two or more points [x, y]")
    points = tuple(_numbers(point, f"{label}[{i}]", 2) for i, point in enumerate(value))
    if points[0] != centre:
        raise SceneError(f"{label} begins at {list(points[0])}; allowed is the person's own centre, {list(centre)}")
    for i, (one, other) in enumerate(pairwise(points)):
        if one == other:
            raise SceneError(f"{label}[{i + 1}] repeats the point before it, {list(other)}")
    return points


def _keys(tree: Any, label: str, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
    allowed = (*needed, *optional)
    if not isinstance(tree, dict):
        raise SceneError(f"{label} is {show(tree)}; allowed is a mapping with the keys {', '.join(allowed)}")
    unknown = [key for key in tree if key not in allowed]
    if unknown:
        raise SceneError(f"{label} has the unknown key {unknown[0]!r}; allowed are {', '.join(allowed)}")
    missing = [key for key in needed if key not in tree]
    if missing:
        raise SceneError(f"{label} lacks the key {missing[0]!r}")


def _one_of(value: Any, label: str, allowed: dict[str, Any]) -> str:
    if not isinstance(value, str) or value not in allowed:
        found = str(value) if isinstance(value, str) else value
        raise SceneError(f"{label} is {show(found)}; allowed are {', '.join(allowed)}")
    return str(value)


def _number(value: Any, label: str, above: float = -MAX_NUMBER, most: float = MAX_NUMBER) -> float:
    try:
        value = values.number(value)
    except ValueError as error:
        raise SceneError(f"{label} is {show(value)}; {error}") from error
    if not isinstance(value, int | float):
        raise SceneError(f"{label} is {show(value)}; allowed is a number")
    if not above < value <= most:  # NaN fails every comparison
        raise SceneError(f"{label} is {show(value)}; allowed is a number above {above:g}, at most {most:g}")
    return float(value)


def _numbers(value: Any, label: str, count: int, above: float = -MAX_NUMBER, most: float = MAX_NUMBER) -> tuple:
    if not isinstance(value, list) or len(value) != count:
        raise SceneError(f"{label} is {show(value)}; allowed is a list of {count} numbers")
    return tuple(_number(item, f"{label}[{i}]", above, most) for i, item in enumerate(value))
