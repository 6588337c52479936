"""Cityscapes as a source of pictures with labels, as the simulator is one.

**View.** A picture is resampled as a level camera would have taken it, at its true angles and at the field of view of
`camera.field_of_view_deg`, so that the rays mean what they mean elsewhere. The data set shows about 45 degrees and no
more; a wider view would have rays at which nobody looked, and is refused. It is half as high as wide: the rows above
and below, of which it tells nothing, have the mean colour of the rest.

**Scale.** Next to nothing in it is within the car's range of 5 m: the bonnet and the lower edge hide the ground up to
about that. So distances are divided by `scale`, 5 unless told otherwise, which maps 25 m of street to the range.
Geometrically that is a world five times smaller, seen from 1.22 m / 5 above the ground: `camera.height_m` of 0.24 says
so in the weights' folder. Pictures of both kinds in one training would contradict each other about how far a thing
is whose foot is seen in a certain row.
"""

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

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
SIGHT_HEIGHT_M = 1.5  # in the street's own metres: what is above, such as a crown, is in nobody's way
_FINER = 4  # pixels of the frame's view for one of the picture's, a side: for thin things, and for a smooth picture
_LEAST_PIXELS, _LEAST_SHARE = 8, 0.03  # of what a ray meets, at a distance or nearer: fewer are stray stereo values
_UNLABELLED_SHARE = 0.5  # of a ray's view; with more, nobody knows what is there
_OUTSIDE = -1  # label of what is not in the frame


@dataclass(frozen=True)
class CityView:
    """One picture and the truth about it; fields as of the simulator's views, for R rays, leftmost first.

    Attributes:
        image: `(size_px, size_px, 3)` uint8.
        ray_clearance_m: `(R,)` float32, horizontal distance over the scale, capped at the camera's range ("free").
        ray_dynamic: `(R,)` bool, whether the ray meets a person, a rider or a vehicle.
        scene: name of the frame.
        scene_hash: of its city and sequence, by which neighbouring frames can be kept together.
    """

    image: np.ndarray
    ray_clearance_m: np.ndarray
    ray_dynamic: np.ndarray
    scene: str
    scene_hash: str


def cityscapes_views(
    folder: Path, split: str, count: int, seed: int, camera: CameraConfig, scale: float = SCALE, first: int = 0
) -> Iterator[CityView]:
    """Pictures of the frames `first` to `first + count` in a drawn order, the same for the same arguments.

    Left out are frames of which a ray looks mostly at what nobody labelled, and what is past the last frame.

    Args:
        folder: root of a Cityscapes copy.
        split: "train" or "val".
        count: of frames, so of pictures at most.
        seed: of the order.
        camera: resolution, field of view and range.
        scale: metres of the street for one of the car's.
        first: number of the first frame in that order; so one order can be shared out.

    Raises:
        DataError: the folder or a file of it is not as expected.
        ConfigError: the field of view is wider than the pictures.
    """
    for level in _levels(folder, split, range(first, first + count), seed, camera, scale):
        yield CityView(level.image, *level.truth(), level.name, level.scene_hash)


def cityscapes_masked_views(
    folder: Path, split: str, count: int, seed: int, camera: CameraConfig, scale: float = SCALE, first: int = 0
) -> Iterator[MaskedView]:
    """The same pictures with their masks; arguments and errors as of `cityscapes_views`.

    Nobody knows what a thing hides. The truth without it takes what is left in view for all there is.
    """
    for level in _levels(folder, split, range(first, first + count), seed, camera, scale):
        whole = level.truth()
        coarse = (slice(_FINER // 2, None, _FINER),) * 2
        labels = level.labels[coarse]
        distance_m = np.where(labels == _OUTSIDE, 0.0, level.distance_m[coarse])  # it is no background to be hidden
        ground, sky = np.isin(labels, GROUND), labels == SKY
        objects, background = choose_masks(level.objects[coarse], distance_m, ground, sky, camera.range_m)
        masks = [Mask(hidden, False, *level.truth(without=number)) for number, hidden in objects.items()]
        masks += [Mask(hidden, True, *whole) for hidden in background]
        yield MaskedView(level.image, *whole, tuple(masks), level.scene_hash)


@dataclass(frozen=True)
class _Level:
    """What a level camera would have seen of a frame, `(n, n)` with n of `_FINER` times the picture's size.

    Attributes:
        name: of the frame.
        image: `(size_px, size_px, 3)` uint8.
        labels: the data set's, or `_OUTSIDE`.
        objects: as of `CityscapesFrame.objects`.
        distance_m: horizontal, over the scale; infinite where it is not known.
        in_the_way: of what stands or moves below `SIGHT_HEIGHT_M`.
        range_m: of the camera.
    """

    name: str
    image: np.ndarray
    labels: np.ndarray
    objects: np.ndarray
    distance_m: np.ndarray
    in_the_way: np.ndarray
    range_m: float

    @property
    def scene_hash(self) -> str:
        """Of its city and sequence."""
        return hashlib.sha256(self.name.rpartition("_")[0].encode()).hexdigest()[:16]

    def truth(self, without: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Distance `(R,)` float32 and "dynamic" `(R,)` of each ray; `without` an object, if one is named."""
        distance_m, dynamic = np.full(RAYS, self.range_m, np.float32), np.zeros(RAYS, bool)
        for ray, columns in enumerate(np.array_split(np.arange(self.labels.shape[1]), RAYS)):
            view = slice(None), slice(columns[0], columns[-1] + 1)
            there = self.in_the_way[view] & (self.distance_m[view] < self.range_m)
            if without is not None:
                there &= self.objects[view] != without
            distances, labels = self.distance_m[view][there], self.labels[view][there]
            if len(distances) < _LEAST_PIXELS:
                continue
            least = max(_LEAST_PIXELS, round(_LEAST_SHARE * len(distances)))
            nearest = np.argpartition(distances, least - 1)[:least]
            distance_m[ray] = distances[nearest].max()
            dynamic[ray] = np.isin(labels[nearest], list(MOVING.values())).mean() > 0.5
        return distance_m, dynamic

    def known(self) -> bool:
        """Whether every ray looks mostly at what has a label."""
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
) -> Iterator[_Level]:
    pictures = frames(Path(folder), split)
    order = np.random.default_rng([seed, *split.encode()]).permutation(len(pictures))
    for index in order[numbers.start : numbers.stop]:
        level = _level(read_frame(pictures[index]), camera, scale)
        if level.known():
            yield level


def _level(frame: CityscapesFrame, camera: CameraConfig, scale: float) -> _Level:
    """A frame as a level camera would have taken it, with distances from stereo or, where it has none, from the ground.

    A pixel of the level view looks along `(1, right, down)`. What stands where the stereo measured nothing is as far
    as the ground below it in its column, which the camera's height tells.
    """
    how, size, n = frame.calibration, camera.size_px, _FINER * camera.size_px
    widest = 2 * math.degrees(math.atan(min(how.u0_px, frame.labels.shape[1] - how.u0_px) / how.fx_px))
    if camera.field_of_view_deg > widest:
        raise ConfigError(
            f"camera.field_of_view_deg is {camera.field_of_view_deg:g}; the Cityscapes frame {frame.name} shows "
            f"{widest:.1f} degrees: allowed is 30 to {math.floor(widest)}"
        )
    right = (math.tan(math.radians(camera.field_of_view_deg) / 2) * (2 * (np.arange(n) + 0.5) / n - 1)).astype("f4")
    down = right[:, None]
    along = math.cos(how.pitch_rad) + math.sin(how.pitch_rad) * down  # of the axis, for each metre ahead
    columns = how.u0_px + how.fx_px * right / along
    rows = how.v0_px + how.fy_px * (math.cos(how.pitch_rad) * down - math.sin(how.pitch_rad)) / along
    rows = np.broadcast_to(rows, columns.shape).astype(np.float32)

    def seen(of: np.ndarray, outside: float) -> np.ndarray:
        return cv2.remap(
            of, columns, rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=[outside] * 4
        )

    labels = seen(frame.labels.astype(np.float32), _OUTSIDE).astype(np.int32)
    objects = seen(frame.objects.astype(np.float32), -1).astype(np.int32)  # numbers are below 2**24: exact
    ahead_m = seen(frame.depth_m, math.inf) / along
    stands = np.isin(labels, (*STANDING.values(), *MOVING.values()))
    ground_m = _ground_below_m(labels, down, how.height_m)
    ahead_m = np.where(stands & ~np.isfinite(ahead_m), ground_m, ahead_m)
    with np.errstate(invalid="ignore"):  # what is infinitely far at the height of the eye
        low = how.height_m - down * ahead_m < SIGHT_HEIGHT_M
    distance_m = (ahead_m * np.hypot(1.0, right) / scale).astype(np.float32)
    return _Level(
        frame.name, _picture(frame, columns, rows, labels != _OUTSIDE, size), labels, objects, distance_m,
        stands & low, camera.range_m,
    )  # fmt: skip


def _ground_below_m(labels: np.ndarray, down: np.ndarray, height_m: float) -> np.ndarray:
    """How far ahead, `(n, n)`, the highest ground is that each pixel has below it; infinite where it has none."""
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
