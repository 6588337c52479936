"""Occupancy maps of Nav2: a YAML file and a picture, read and written by the rules of its map_server.

The rules are those of `nav2_map_server` (`map_io.cpp`). A picture's first row is the northernmost one. The origin is
the outer corner of its lower left cell, with a yaw by which the whole map is turned about that corner. Nav2's static
layer ignores this yaw; here it counts.
"""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from reprlib import repr as show
from typing import Any

import numpy as np
import yaml
from PIL import Image

from zsdist.common import strict_yaml, values
from zsdist.errors import SceneError
from zsdist.sim.maps import pictures

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
LETHAL = OCCUPIED  # Nav2's lethal_cost_threshold by default
MODES = ("trinary", "scale", "raw")
MAX_FILE_BYTES = 2**16
SAVED_UNKNOWN = 205  # grey that map_saver writes for unknown cells: occupied by 0.196
SAVED_FREE, SAVED_OCCUPIED = 254, 0
FREE_THRESHOLD, OCCUPIED_THRESHOLD = 0.196, 0.65  # of maps that map_saver writes today
_NEEDED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")


@dataclass(frozen=True)
class Rules:
    """Rules by which a map's picture is read.

    Attributes:
        mode: `trinary`, `scale` or `raw`.
        negate: whether white is occupied; without effect on raw maps.
        occupied_thresh: least share of darkness of an occupied cell.
        free_thresh: greatest share of darkness of a free cell.
    """

    mode: str = "trinary"
    negate: bool = False
    occupied_thresh: float = OCCUPIED_THRESHOLD
    free_thresh: float = FREE_THRESHOLD


@dataclass(frozen=True)
class OccupancyMap:
    """Occupancy map in its own frame.

    Attributes:
        name: name of its YAML file, without the ending.
        cells: `[row, column]` `(rows, columns)` int8, from the lower left cell: -1 unknown, else 0 free to 100
            occupied.
        resolution_m: side of a cell.
        origin: `(x_m, y_m, yaw_rad)` of the outer corner of the lower left cell.
        doubtful: `(rows, columns)` bool, cells of the grey that map_saver writes for unknown ones, but which the map's
            own thresholds make free.
    """

    name: str
    cells: np.ndarray
    resolution_m: float
    origin: tuple[float, float, float]
    doubtful: np.ndarray = field(repr=False)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the map in metres, along its own rows and columns."""
        rows, columns = self.cells.shape
        return columns * self.resolution_m, rows * self.resolution_m

    def to_world(self, along_m: float, up_m: float) -> tuple[float, float]:
        """Return the point of the map's frame that lies so far along the picture's rows and up its columns."""
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        return x + along_m * cos - up_m * sin, y + along_m * sin + up_m * cos

    def to_picture(self, x_m: np.ndarray, y_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how far points of the map's frame lie along the picture's rows and up its columns, in metres."""
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        return (x_m - x) * cos + (y_m - y) * sin, (y_m - y) * cos - (x_m - x) * sin


def is_map(tree: Any) -> bool:
    """Return whether a YAML tree looks like that of a map, not of a scene."""
    return isinstance(tree, dict) and "image" in tree and "resolution" in tree


def read(path: Path) -> OccupancyMap:
    """Return the map of a YAML file and its picture.

    Raises:
        SceneError: one of the two is unreadable or wrong; the message is one line with the file and the reason.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise SceneError(f"file is larger than the {MAX_FILE_BYTES} bytes allowed; it names its picture by `image`")
        tree = strict_yaml.load(path.read_text(encoding="utf-8"))
        image, resolution_m, origin, rules = _head(tree)
        grey, transparent = pictures.read(path.parent / image)
    except OSError as error:
        raise SceneError(f"map {path}: {error.strerror or error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: not UTF-8
        raise SceneError(f"map {path} is no YAML file: {' '.join(str(error).split())}") from error
    except SceneError as error:
        raise SceneError(f"map {path}: {error}") from error
    cells = occupancy(grey, transparent, rules)
    doubtful = (grey == (255 - SAVED_UNKNOWN if rules.negate else SAVED_UNKNOWN)) & (cells == FREE)
    if rules.mode == "raw":
        doubtful[:] = False
    return OccupancyMap(path.stem, np.flipud(cells), resolution_m, origin, np.flipud(doubtful))


def occupancy(grey: np.ndarray, transparent: np.ndarray | None, rules: Rules) -> np.ndarray:
    """Return the occupancy of a picture's pixels by map_server's rules, the same shape, int8.

    * trinary: a darkness of `occupied_thresh` or more is occupied, of `free_thresh` or less is free, else unknown.
    * scale: the same, and darkness in between becomes 0 to 100.
    * raw: the grey value is the occupancy; above 100 is unknown.

    Where a picture is transparent, trinary and scale are unknown. As in map_server, darkness is a 32 bit number, and a
    cell that is both free and occupied, since the thresholds overlap, is free.

    Args:
        grey: `(rows, columns)` uint8.
        transparent: the same shape, bool; None: nowhere.
        rules: rules of the map.
    """
    if rules.mode == "raw":
        return np.where(grey > OCCUPIED, UNKNOWN, grey).astype(np.int8)
    dark = grey.astype(np.float32) / np.float32(255)
    if not rules.negate:
        dark = np.float32(1) - dark
    least, most = np.float32(rules.occupied_thresh), np.float32(rules.free_thresh)
    found = np.full(grey.shape, UNKNOWN, np.int8)
    found[dark >= least] = OCCUPIED
    found[dark <= most] = FREE
    if rules.mode == "scale":
        between = (dark > most) & (dark < least)
        span = np.float32(rules.occupied_thresh - rules.free_thresh)
        found[between] = np.floor((dark[between] - most) / span * np.float32(100) + np.float32(0.5))
    if transparent is not None:
        found[transparent] = UNKNOWN
    return found


def write(
    occupied: np.ndarray, resolution_m: float, origin_m: tuple[float, float], file: Path, ending: str = "png"
) -> None:
    """Write a map as `file`, a YAML, and a picture beside it, so that map_server reads back the same cells.

    Args:
        occupied: `[row, column]` bool from the lower left cell; all others are free.
        resolution_m: side of a cell.
        origin_m: outer corner of the lower left cell.
        file: YAML file to write.
        ending: `png` or `pgm`.
    """
    grey = np.flipud(np.where(occupied, SAVED_OCCUPIED, SAVED_FREE).astype(np.uint8))
    picture = file.with_suffix(f".{ending}")
    Image.fromarray(grey).save(picture, format={"png": "PNG", "pgm": "PPM"}[ending])
    lines = (
        f"image: {json.dumps(picture.name, ensure_ascii=False)}",
        "mode: trinary",
        f"resolution: {resolution_m:g}",
        f"origin: [{origin_m[0]:g}, {origin_m[1]:g}, 0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESHOLD}",
        f"free_thresh: {FREE_THRESHOLD}",
    )
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _head(tree: Any) -> tuple[str, float, tuple[float, float, float], Rules]:
    if not isinstance(tree, dict):
        raise SceneError(f"it holds {show(tree)}; allowed is a mapping with the keys {', '.join(_NEEDED)}")
    if "obstacles" in tree and "image" not in tree:
        raise SceneError("it is a scene already; allowed is the YAML file of a map, with `image` and `resolution`")
    for key in _NEEDED:
        if key not in tree:
            raise SceneError(f"it lacks the key {key!r}; needed are {', '.join(_NEEDED)}")
    image = tree["image"]
    if not isinstance(image, str) or not image.strip():
        raise SceneError(f"image is {show(image)}; allowed is the name of a picture")
    resolution_m = _number(tree["resolution"], "resolution")
    if not 0.001 <= resolution_m <= 1.0:
        raise SceneError(f"resolution is {resolution_m:g}; allowed is 0.001 to 1 m")
    origin = tree["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise SceneError(f"origin is {show(origin)}; allowed is a list of x, y and yaw")
    x, y, yaw = (_number(item, f"origin[{index}]") for index, item in enumerate(origin))
    mode = str(tree.get("mode", "trinary")).lower()
    if mode not in MODES:
        raise SceneError(f"mode is {show(tree['mode'])}; allowed are {', '.join(MODES)}")
    try:
        negate = values.typed(bool, tree["negate"])
    except ValueError:
        negate = _number(tree["negate"], "negate") != 0  # any number, as in map_server
    thresholds = (_number(tree[key], key) for key in ("occupied_thresh", "free_thresh"))
    return str(image), resolution_m, (x, y, yaw), Rules(mode, negate, *thresholds)


def _number(value: Any, label: str) -> float:
    try:
        found = values.number(value)
    except ValueError as error:
        raise SceneError(f"{label} is {show(value)}; {error}") from error
    if not isinstance(found, int | float) or not math.isfinite(found):
        raise SceneError(f"{label} is {show(value)}; allowed is a number")
    return float(found)
