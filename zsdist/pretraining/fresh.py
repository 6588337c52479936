"""Fresh pictures for the compact network, made in other processes while it trains, an epoch ahead.

Name and seed determine the content of a shard, so the number of processes and interruptions have no effect.
"""

import itertools
import math
import os
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path

import numpy as np

from zsdist.common import process_pool as pool
from zsdist.config import CameraConfig
from zsdist.datasets.labelled import LabelledView, fresh_views
from zsdist.pretraining.job import PURPOSE, Job
from zsdist.sim.scenes.manifest import Split
from zsdist.vision.cityscapes.files import frames
from zsdist.vision.cityscapes.views import CityView, cityscapes_views
from zsdist.vision.models import COMPACT_PX, COMPACT_ROWS
from zsdist.vision.rays import RAYS, ray_angles_rad
from zsdist.vision.training.examples import Examples

EPOCH = 4096  # pictures of an epoch, which are in memory twice: those of the next one are made meanwhile
SHARD = 256  # pictures that a process makes at a time
VALIDATION = 1024  # pictures of the validation
_NICENESS = 10  # the training goes first: it needs several times the processor time of its pictures


def epoch_pictures(job: Job) -> int:
    """Return the number of pictures of an epoch."""
    return min(EPOCH, job.images)


def validation(job: Job) -> Examples:
    """Return pictures of other scenes, for the choice of the epoch and the calibration."""
    return _make(job, "validation", 0, min(VALIDATION, job.images))


def epochs(job: Job, workers: int, first: int) -> Generator[Examples, None, None]:
    """Yield the pictures of epoch `first` and of all later ones. Close the generator to end its processes."""
    shards = math.ceil(epoch_pictures(job) / SHARD)
    numbers = (number for number in itertools.count(first * shards))
    made = pool.each(_make_shard, numbers, workers, _begin, (job, workers > 1), ahead=shards)
    try:
        while True:
            yield _joined(list(itertools.islice(made, shards)))
    finally:
        made.close()


class _Worker:
    """State of a process that makes shards."""

    job: Job


def _begin(job: Job, apart: bool) -> None:
    _Worker.job = job
    if apart:
        os.nice(_NICENESS)


def _make_shard(number: int) -> Examples:
    job = _Worker.job
    place = number % math.ceil(epoch_pictures(job) / SHARD)
    return _make(job, "train", number, min(SHARD, epoch_pictures(job) - place * SHARD))


def _make(job: Job, use: str, number: int, count: int) -> Examples:
    """Return the pictures of a shard; of photographs there may be fewer than `count`."""
    seed, camera = job.shard_seed(f"fresh-{use}-{number:06d}"), _camera(job)
    views: Iterator[LabelledView | CityView]
    if job.cityscapes:
        views = _photographs(job, use, number, count, camera)
    else:
        split: Split = PURPOSE.split if use == "train" else "validation"
        views = fresh_views(list(job.families), split, count, seed, camera)
    rows = [(view.image[-COMPACT_ROWS:], view.ray_clearance_m, view.ray_dynamic) for view in views]
    images, distance_m, dynamic = (np.stack(column) for column in zip(*rows, strict=True))
    return Examples(images, distance_m, dynamic, ray_angles_rad(RAYS, math.radians(camera.field_of_view_deg)))


def _photographs(job: Job, use: str, number: int, count: int, camera: CameraConfig) -> Iterator[CityView]:
    folder, split = Path(job.cityscapes), "train" if use == "train" else "val"
    first = number * SHARD % max(len(frames(folder, split)) - count + 1, 1)
    return cityscapes_views(folder, split, count, job.seed, camera, first=first)


def _camera(job: Job) -> CameraConfig:
    return job.config.camera.model_copy(update={"size_px": COMPACT_PX})


def _joined(parts: Sequence[Examples]) -> Examples:
    tokens, distance_m, dynamic = (
        np.concatenate(column)
        for column in zip(*((part.tokens, part.ray_distance_m, part.ray_dynamic) for part in parts), strict=True)
    )
    return Examples(tokens, distance_m, dynamic, parts[0].ray_angles_rad)
