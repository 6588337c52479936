"""Cityscapes as a source of pictures with labels, with the same fields as the simulator's data sets.

**View.** A picture is resampled as a level camera would have taken it, at its true angles and at the field of view of
`camera.field_of_view_deg`, so that rays have the same meaning as elsewhere. The data set covers about 45 degrees; a
wider view would have rays without data and is refused. A frame is half as high as wide: the rows above and below it
are filled with the mean colour of the rest.

**Scale.** Almost nothing in the frames is within the car's range of 5 m: the bonnet and the lower edge hide the ground
up to about that distance. So distances are divided by `scale`, 5 by default, which maps 25 m of street to the range.
Geometrically that is a world five times smaller, seen from 1.22 m / 5 above the ground; the weights' folder states it
as `camera.height_m` 0.24. Pictures of both scales in one training would contradict each other about the distance of an
object whose foot is in a given row.
"""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from zsdist.common import random_streams
from zsdist.config import CameraConfig
from zsdist.errors import ConfigError
from zsdist.vision.cityscapes.files import (
    BORDER,
    EGO_VEHICLE,
    GROUND,
    MOVING,
    SKY,
    STANDING,
    CityscapesFrame,
    frames,
    read_frame,
)
from zsdist.vision.masks import Mask, MaskedView, choose_masks
from zsdist.vision.rays import RAYS

SCALE = 5.0
SIGHT_HEIGHT_M = 1.5  # in metres of the street: parts of objects above it, such as a tree crown, do not obstruct
_FINER = 4  # pixels of the level view per pixel of the picture, along a side: keeps thin objects, smooths the picture
# A ray's distance needs so many pixels, and such a share of its hits, at it or nearer: fewer are stray stereo values.
_LEAST_PIXELS, _LEAST_SHARE = 8, 0.03
_UNLABELLED_SHARE = 0.5  # share of a ray's pixels; with more unlabelled ones its content is unknown
_OUTSIDE = -1  # label of pixels outside the frame


@dataclass(frozen=True)
class CityView:
    """One picture and its truth for R rays, leftmost first; fields as in the simulator's views.

    Attributes:
        image: `(size_px, size_px, 3)` uint8.
        ray_clearance_m: `(R,)` float32, horizontal distance over the scale, capped at the camera's range ("free").
        ray_dynamic: `(R,)` bool, whether the ray meets a person, a rider or a vehicle.
        scene: name of the frame.
        scene_hash: hash of city and sequence; it groups neighbouring frames.
    """

    image: np.ndarray
    ray_clearance_m: np.ndarray
    ray_dynamic: np.ndarray
    scene: str
    scene_hash: str


def cityscapes_views(
    folder: Path, split: str, count: int, seed: int, camera: CameraConfig, scale: float = SCALE, first: int = 0
) -> Iterator[CityView]:
    """Yield pictures of the frames `first` to `first + count` in a random order, the same for the same arguments.

    Frames with a ray of mostly unlabelled pixels are skipped. If the split ends, there are fewer pictures.

    Args:
        folder: root of a Cityscapes copy.
        split: "train" or "val".
        count: number of frames, which is the greatest number of pictures.
        seed: seed of the order.
        camera: resolution, field of view and range.
        scale: metres of street that count as one metre.
        first: number of the first frame in the random order, so that several callers can share one order.

    Raises:
        DataError: the folder or one of its files is not as expected.
        ConfigError: the field of view is wider than the frames.
    """
    for level in _levels(folder, split, range(first, first + count), seed, camera, scale):
        yield CityView(level.image, *level.truth(), level.name, level.scene_hash)


def cityscapes_masked_views(
    folder: Path, split: str, count: int, seed: int, camera: CameraConfig, scale: float = SCALE, first: int = 0
) -> Iterator[MaskedView]:
    """Yield the same pictures with their masks; arguments and errors as in `cityscapes_views`.

    The scene behind an object is unknown, so the truth without the object comes from the remaining pixels alone.
    """
    for level in _levels(folder, split, range(first, first + count), seed, camera, scale):
        whole = level.truth()
        coarse = (slice(_FINER // 2, None, _FINER),) * 2
        labels = level.labels[coarse]
        distance_m = np.where(labels == _OUTSIDE, 0.0, level.distance_m[coarse])  # so it is not masked as background
        ground, sky = np.isin(labels, GROUND), labels == SKY
        objects, background = choose_masks(level.objects[coarse], distance_m, ground, sky, camera.range_m)
        masks = [Mask(hidden, False, *level.truth(without=number)) for number, hidden in objects.items()]
        masks += [Mask(hidden, True, *whole) for hidden in background]
        yield MaskedView(level.image, *whole, tuple(masks), level.scene_hash)


@dataclass(frozen=True)
class _LevelView:
    """Frame as a level camera sees it, in arrays `(n, n)`, where n is `_FINER` times the picture's size.

    Attributes:
        name: name of the frame.
        image: `(size_px, size_px, 3)` uint8.
        labels: label of each pixel in the data set, or `_OUTSIDE`.
        objects: object at each pixel, as in `CityscapesFrame.objects`.
        distance_m: horizontal distance divided by the scale; infinite if unknown.
        obstructs: whether a pixel shows a standing or moving object below `SIGHT_HEIGHT_M`.
        range_m: range of the camera, in metres.
    """

    name: str
    image: np.ndarray
    labels: np.ndarray
    objects: np.ndarray
    distance_m: np.ndarray
    obstructs: np.ndarray
    range_m: float

    @property
    def scene_hash(self) -> str:
        """Hash of the city and the sequence."""
        return hashlib.sha256(self.name.rpartition("_")[0].encode()).hexdigest()[:16]

    def truth(self, without: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return each ray's distance `(R,)` float32, in m, and "dynamic" `(R,)` bool, ignoring the object `without`."""
        distance_m, dynamic = np.full(RAYS, self.range_m, np.float32), np.zeros(RAYS, bool)
        for ray, columns in enumerate(np.array_split(np.arange(self.labels.shape[1]), RAYS)):
            view = slice(None), slice(columns[0], columns[-1] + 1)
            hits = self.obstructs[view] & (self.distance_m[view] < self.range_m)
            if without is not None:
                hits &= self.objects[view] != without
            distances, labels = self.distance_m[view][hits], self.labels[view][hits]
            if len(distances) < _LEAST_PIXELS:
                continue
            least = max(_LEAST_PIXELS, round(_LEAST_SHARE * len(distances)))
            nearest = np.argpartition(distances, least - 1)[:least]
            distance_m[ray] = distances[nearest].max()
            dynamic[ray] = np.isin(labels[nearest], list(MOVING.values())).mean() > 0.5
        return distance_m, dynamic

    def is_labelled(self) -> bool:
        """Return whether every ray covers mostly labelled pixels."""
        counted = ~np.isin(self.labels, (_OUTSIDE, EGO_VEHICLE, *BORDER))
        unlabelled = counted & (self.labels == 0)
        sums = [
            (np.count_nonzero(part), np.count_nonzero(of))
            for part, of in zip(
                np.array_split(unlabelled, RAYS, axis=1), np.array_split(counted, RAYS, axis=1), strict=True
            )
        ]
        return all(of > 0 and part <= _UNLABELLED_SHARE * of for part, of in sums)


def _levels(
    folder: Path, split: str, numbers: range, seed: int, camera: CameraConfig, scale: float
) -> Iterator[_LevelView]:
    pictures = frames(Path(folder), split)
    order = random_streams.labelled_pictures(seed, split).permutation(len(pictures))
    for index in order[numbers.start : numbers.stop]:
        level = _level_view(read_frame(pictures[index]), camera, scale)
        if level.is_labelled():
            yield level


def _level_view(frame: CityscapesFrame, camera: CameraConfig, scale: float) -> _LevelView:
    """Return a frame as a level camera would have taken it, with distances from stereo, or else from the ground.

    A pixel of the level view has the direction `(1, right, down)`. An object without a stereo measurement is as far
    away as the ground below it in its column, whose distance follows from the camera's height.
    """
    eye, size, n = frame.calibration, camera.size_px, _FINER * camera.size_px
    widest = 2 * math.degrees(math.atan(min(eye.u0_px, frame.labels.shape[1] - eye.u0_px) / eye.fx_px))
    if camera.field_of_view_deg > widest:
        raise ConfigError(
            f"camera.field_of_view_deg is {camera.field_of_view_deg:g}; the Cityscapes frame {frame.name} shows "
            f"{widest:.1f} degrees: allowed is 30 to {math.floor(widest)}"
        )
    right = (math.tan(math.radians(camera.field_of_view_deg) / 2) * (2 * (np.arange(n) + 0.5) / n - 1)).astype("f4")
    down = right[:, None]
    along = math.cos(eye.pitch_rad) + math.sin(eye.pitch_rad) * down  # metres along the axis per metre ahead
    columns = eye.u0_px + eye.fx_px * right / along
    rows = eye.v0_px + eye.fy_px * (math.cos(eye.pitch_rad) * down - math.sin(eye.pitch_rad)) / along
    rows = np.broadcast_to(rows, columns.shape).astype(np.float32)

    def sample(of: np.ndarray, outside: float) -> np.ndarray:
        return cv2.remap(
            of, columns, rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=[outside] * 4
        )

    labels = sample(frame.labels.astype(np.float32), _OUTSIDE).astype(np.int32)
    objects = sample(frame.objects.astype(np.float32), -1).astype(np.int32)  # numbers are below 2**24: exact
    ahead_m = sample(frame.depth_m, math.inf) / along
    stands = np.isin(labels, (*STANDING.values(), *MOVING.values()))
    ground_m = _ground_below_m(labels, down, eye.height_m)
    ahead_m = np.where(stands & ~np.isfinite(ahead_m), ground_m, ahead_m)
    with np.errstate(invalid="ignore"):  # zero times infinity, at the height of the camera
        low = eye.height_m - down * ahead_m < SIGHT_HEIGHT_M
    distance_m = (ahead_m * np.hypot(1.0, right) / scale).astype(np.float32)
    return _LevelView(
        frame.name, _picture(frame, columns, rows, labels != _OUTSIDE, size), labels, objects, distance_m,
        stands & low, camera.range_m,
    )  # fmt: skip


def _ground_below_m(labels: np.ndarray, down: np.ndarray, height_m: float) -> np.ndarray:
    """Return the distance ahead, `(n, n)`, of the nearest ground row below each pixel; infinite if there is none."""
    ground = np.isin(labels, GROUND) & (down > 0)
    ahead_m = np.where(ground, height_m / np.maximum(down, 1e-6), np.inf)
    n = len(labels)
    row = np.where(ground, np.arange(n)[:, None], n)
    below = np.minimum.accumulate(row[::-1], axis=0)[::-1]
    return np.where(below < n, np.take_along_axis(ahead_m, np.minimum(below, n - 1), 0), np.inf)


def _picture(
    frame: CityscapesFrame, columns: np.ndarray, rows: np.ndarray, inside: np.ndarray, size: int
) -> np.ndarray:
    fine = cv2.remap(
        np.ascontiguousarray(frame.picture), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    fine[~inside] = np.rint(fine[inside].mean(0)).astype(np.uint8)
    return cv2.resize(fine, (size, size), interpolation=cv2.INTER_AREA)
