"""Reader of the files of a Cityscapes copy, with an error that names each missing or damaged file.

A frame `<city>_<sequence>_<frame>` has files in four folders, `<folder>/<split>/<city>/`: the picture in
`leftImg8bit`, polygons and instance numbers in `gtFine`, the calibration in `camera`, the stereo in `disparity`.
"""

import json
import math
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from zsdist.common import folders
from zsdist.errors import DataError

SPLITS = ("train", "val")  # the annotations of other splits are coarse or withheld
EGO_VEHICLE, BORDER = 1, (2, 3)
GROUND = (6, 7, 8, 9, 10, 22)  # ground, road, sidewalk, parking, rails, terrain
SKY = 23
STANDING = {
    "static": 4, "dynamic": 5, "building": 11, "wall": 12, "fence": 13, "guard rail": 14, "bridge": 15, "tunnel": 16,
    "pole": 17, "polegroup": 18, "traffic light": 19, "traffic sign": 20, "vegetation": 21,
}  # fmt: skip
MOVING = {
    "person": 24, "rider": 25, "car": 26, "truck": 27, "bus": 28, "caravan": 29, "trailer": 30, "train": 31,
    "motorcycle": 32, "bicycle": 33,
}  # fmt: skip
_INSTANCES_A_LABEL = 1000  # an instance number is label times this plus a counter; below this it is a label
_PARTS = {  # files of a frame besides its picture: folder, end of the name, package to download
    "polygons": ("gtFine", "_gtFine_polygons.json", "gtFine_trainvaltest.zip"),
    "instances": ("gtFine", "_gtFine_instanceIds.png", "gtFine_trainvaltest.zip"),
    "camera": ("camera", "_camera.json", "camera_trainvaltest.zip"),
    "disparity": ("disparity", "_disparity.png", "disparity_trainvaltest.zip"),
}
_PICTURE = "_leftImg8bit.png"
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Calibration:
    """Calibration of the left camera, in pixels, metres and radians.

    Attributes:
        fx_px, fy_px: horizontal and vertical focal length.
        u0_px, v0_px: column and row of the optical axis.
        baseline_m: distance between the two cameras of the stereo pair.
        pitch_rad: pitch of the optical axis, positive downwards.
        height_m: height of the camera above the ground.
    """

    fx_px: float
    fy_px: float
    u0_px: float
    v0_px: float
    baseline_m: float
    pitch_rad: float
    height_m: float


@dataclass(frozen=True)
class CityscapesFrame:
    """One frame as stored on disk.

    Attributes:
        name: `<city>_<sequence>_<frame>`.
        picture: `(H, W, 3)` uint8, RGB.
        labels: `(H, W)` int32, the data set's label of each pixel.
        objects: `(H, W)` int32, number of the standing or moving object at each pixel; -1: none. It is the data set's
            instance number, or, for labels without instances, the number of the polygon.
        depth_m: `(H, W)` float32, depth along the camera's axis; infinite if not measured.
        calibration: calibration of the camera.
    """

    name: str
    picture: np.ndarray
    labels: np.ndarray
    objects: np.ndarray
    depth_m: np.ndarray
    calibration: Calibration


def frames(folder: Path, split: str) -> list[Path]:
    """Return the paths of a split's pictures, in order of their names.

    Raises:
        DataError: the split is unknown, or the folder has no pictures of it.
    """
    if split not in SPLITS:
        raise DataError(f"Cityscapes split is {split!r}; allowed are {', '.join(SPLITS)}")
    found = folders.visible(folder / "leftImg8bit" / split, f"*/*{_PICTURE}")
    if not found:
        raise DataError(
            f"folder {folder} has no leftImg8bit/{split}/<city>/*{_PICTURE}; expected is the root of a Cityscapes "
            "copy, with leftImg8bit, gtFine, camera and disparity in it"
        )
    return found


def read_frame(picture: Path) -> CityscapesFrame:
    """Return the frame of a picture that `frames` found.

    Raises:
        DataError: a file is missing or damaged, or does not match the others.
    """
    name = picture.name.removesuffix(_PICTURE)
    if not re.fullmatch(r".+_\d{6}_\d{6}", name):
        raise DataError(f"picture {picture} has an unknown name; expected is <city>_000000_000000{_PICTURE}")
    root, split, city = picture.parents[3], picture.parents[1].name, picture.parent.name
    parts = {}
    for part, (folder, end, package) in _PARTS.items():
        parts[part] = root / folder / split / city / f"{name}{end}"
        if not parts[part].is_file():
            raise DataError(f"Cityscapes frame {name} lacks {parts[part]}; it is in the package {package}")
    image = _png(picture, np.uint8, 3)[..., ::-1]
    calibration = _calibration(parts["camera"], image.shape[:2])
    instances = _png(parts["instances"], np.uint16, 1).astype(np.int32)
    values = _png(parts["disparity"], np.uint16, 1)
    for part, array in (("instances", instances), ("disparity", values)):
        if array.shape != image.shape[:2]:
            raise DataError(f"{parts[part]} is {array.shape} pixels; expected is {image.shape[:2]}, as in the picture")
    labels = np.where(instances < _INSTANCES_A_LABEL, instances, instances // _INSTANCES_A_LABEL)
    depth_m = np.full(values.shape, np.inf, np.float32)
    measured = values > 1  # 0: not measured; 1: no disparity, so infinitely far
    depth_m[measured] = calibration.baseline_m * calibration.fx_px / ((values[measured] - 1.0) / 256.0)
    objects = _objects(_polygons(parts["polygons"]), instances, labels)
    return CityscapesFrame(name, image, labels, objects, depth_m, calibration)


def _objects(polygons: list[tuple[str, np.ndarray]], instances: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return `CityscapesFrame.objects` from the polygons' labels and corners, in the order in which they were drawn."""
    drawn = np.full(instances.shape, -1, np.int32)
    for number, (label, corners) in enumerate(polygons):
        if label in STANDING:
            patch = np.zeros(instances.shape, np.uint8)
            cv2.fillPoly(patch, [corners], 1)
            drawn[(patch == 1) & (labels == STANDING[label])] = number
    return np.where(instances >= _INSTANCES_A_LABEL, instances, drawn)


def _polygons(path: Path) -> list[tuple[str, np.ndarray]]:
    """Return the label and the corners `(K, 2)` int32, in pixels, of each polygon."""
    objects = _json(path, "objects")["objects"]
    try:
        return [
            (str(entry["label"]), np.array(entry["polygon"], np.float64).reshape(-1, 2).round().astype(np.int32))
            for entry in objects
            if not entry.get("deleted") and entry["polygon"]
        ]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path} has objects without a label and a polygon of points: {error!r}") from error


def _calibration(path: Path, shape: tuple[int, int]) -> Calibration:
    tree = _json(path, "intrinsic", "extrinsic")
    wanted = [("intrinsic", key) for key in ("fx", "fy", "u0", "v0")]
    wanted += [("extrinsic", key) for key in ("baseline", "pitch", "z")]
    numbers = []
    for part, key in wanted:
        value: Any = tree[part].get(key) if isinstance(tree[part], dict) else None
        positive = key in ("fx", "fy", "baseline", "z")
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value) or (positive and value <= 0):
            raise DataError(f"{path} has {part}.{key} {value!r}; expected is a number{' above 0' * positive}")
        numbers.append(float(value))
    result = Calibration(*numbers)
    for axis, size, of in ((result.u0_px, shape[1], "width"), (result.v0_px, shape[0], "height")):
        if not 0.3 < axis / size < 0.7:
            raise DataError(
                f"{path} has the axis at pixel {axis:g}, far from the middle of the picture's {of}, {size}; expected "
                "are pictures in the size of the calibration, 2048 x 1024"
            )
    return result


def _json(path: Path, *keys: str) -> dict[str, Any]:
    try:
        tree = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read as JSON: {error}") from error
    missing = [key for key in keys if not isinstance(tree, dict) or key not in tree]
    if missing:
        raise DataError(f"{path} lacks the key {missing[0]!r}; expected are {', '.join(keys)}")
    return tree


def _png(path: Path, dtype: type, channels: int) -> np.ndarray:
    """Return a PNG image, `(H, W)` or `(H, W, 3)` BGR; raise `DataError` unless the file is whole and of this type."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from error
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if _whole(data) else None
    if image is None:
        raise DataError(f"{path} is damaged: {len(data)} bytes that are not a complete PNG file")
    found = 1 if image.ndim == 2 else image.shape[2]
    if image.dtype != dtype or found != channels:
        expected = f"{channels} of {np.dtype(dtype).itemsize * 8} bit"
        raise DataError(f"{path} has {found} channels of {image.dtype.itemsize * 8} bit; expected is {expected}")
    return image


def _whole(data: bytes) -> bool:
    """Return whether a PNG file has all its chunks with valid checksums; decoders accept truncated files."""
    at = len(_PNG)
    if data[:at] != _PNG:
        return False
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4])
        kind_and_body = memoryview(data)[at + 4 : at + 8 + length]
        if zlib.crc32(kind_and_body) != int.from_bytes(data[at + 8 + length : at + 12 + length]):
            return False
        if kind_and_body[:4] == b"IEND":
            return True
        at += 12 + length
    return False
