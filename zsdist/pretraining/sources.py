"""Sources of the pictures of a pretraining, and the rendering and encoding of their shards.

* `act`: pictures that the head and the student learn from;
* `validation`: the same from other scenes, for early stopping and calibration;
* `masked`: pictures and their masked versions, for the contrast;
* `described`, `described-validation`: pictures with captions, for the projection alone; the head sees no such scene.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zsdist.datasets.captioned import CaptionedView, captioned_views
from zsdist.datasets.labelled import LabelledView, labelled_views
from zsdist.datasets.masked import masked_views
from zsdist.pretraining.batches import BATCH, batched
from zsdist.pretraining.job import PURPOSE, Job
from zsdist.sim.scenes.manifest import MANIFEST
from zsdist.vision.cityscapes.files import frames
from zsdist.vision.cityscapes.views import CityView, cityscapes_masked_views, cityscapes_views
from zsdist.vision.encoders.base import Encoder, resample
from zsdist.vision.masks import Mask, MaskedView, hide
from zsdist.vision.models import STUDENT_PX

# Size of a source as a share of the number of pictures to train the head on.
VALIDATION_SHARE = 0.08
CITY_VALIDATION_SHARE = 0.17  # there are 2,975 photographs to train on and 500 for validation
MASKED_SHARE = 0.07
DESCRIBED_SHARE = 0.2
SHARD = 512  # number of pictures per shard, such that two families have equally many scenes
MASKED_SHARD = 64  # number of pictures per shard, each with about nine masks
_MASKS = 9  # average number of masks of a picture, for the estimate of disk space

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class PictureShard:
    """Part of a source: `count` pictures, determined by its name and the seed of the pretraining."""

    source: str
    index: int
    count: int

    @property
    def name(self) -> str:
        """Name of the shard's folder."""
        return f"{self.source}-{self.index:04d}"


@dataclass(frozen=True)
class Source:
    """Source of pictures of one kind.

    Attributes:
        pictures: number of pictures.
        shard: number of pictures per shard.
        make: function that makes a shard's arrays from the job, the shard, its seed and the encoder.
    """

    pictures: int
    shard: int
    make: "Callable[[Job, PictureShard, int, Encoder], Arrays]"

    def picture_bytes(self, encoder: Encoder) -> int:
        """Return the disk space of a picture in bytes."""
        tokens = 2 * encoder.side**2 * encoder.features
        return tokens * (1 + _MASKS) if self.make in (_masked, _city_masked) else tokens + STUDENT_PX**2 * 3


def sources(job: Job) -> dict[str, Source]:
    """Return the sources of a pretraining by name.

    Raises:
        DataError: the folder of photographs holds none.
    """
    found: dict[str, Source] = {}
    if "head" in job.stages:
        found |= _photographs(job) if job.cityscapes else _rendered(job)
        if "words" not in job.stages:
            del found["masked"]
    if "words" in job.stages:
        found["described"] = Source(_share(DESCRIBED_SHARE, job.images), SHARD // 2, _described)
        count = _share(DESCRIBED_SHARE * VALIDATION_SHARE, job.images)
        found["described-validation"] = Source(count, SHARD // 2, _described)
    return {name: source for name, source in found.items() if source.pictures}


def _rendered(job: Job) -> dict[str, Source]:
    return {
        "act": Source(job.images, SHARD, _act),
        "validation": Source(_share(VALIDATION_SHARE, job.images), SHARD, _act),
        "masked": Source(_share(MASKED_SHARE, job.images), MASKED_SHARD, _masked),
    }


def _photographs(job: Job) -> dict[str, Source]:
    training = len(frames(Path(job.cityscapes), "train"))
    validation = len(frames(Path(job.cityscapes), "val"))
    return {
        "act": Source(min(job.images, training), SHARD // 4, _city_act),
        "validation": Source(min(_share(CITY_VALIDATION_SHARE, job.images), validation), SHARD // 4, _city_validation),
        "masked": Source(min(_share(MASKED_SHARE, job.images), training), MASKED_SHARD, _city_masked),
    }


def _share(share: float, images: int) -> int:
    return math.ceil(share * images)


def shards(wanted: dict[str, Source]) -> list[PictureShard]:
    """Return all shards in an order in which all sources advance evenly, so that work may stop at any shard."""
    positions = []
    for name, source in wanted.items():
        count = math.ceil(source.pictures / source.shard)
        for index in range(count):
            size = min(source.shard, source.pictures - index * source.shard)
            positions.append(((index + 0.5) / count, PictureShard(name, index, size)))
    return [shard for _, shard in sorted(positions, key=lambda entry: (entry[0], entry[1].source))]


def make(job: Job, shard: PictureShard, encoder: Encoder) -> Arrays:
    """Render and encode a shard; return arrays by name with one row per picture or mask."""
    return sources(job)[shard.source].make(job, shard, job.shard_seed(shard.name), encoder)


def _act(job: Job, shard: PictureShard, seed: int, encoder: Encoder) -> Arrays:
    camera = job.config.camera
    views = labelled_views(list(job.families), PURPOSE.split, shard.count, seed, camera, varied=True)
    return _encode_act(views, encoder)


def _city_act(job: Job, shard: PictureShard, seed: int, encoder: Encoder) -> Arrays:
    return _encode_act(_city_views(job, shard, "train"), encoder)


def _city_validation(job: Job, shard: PictureShard, seed: int, encoder: Encoder) -> Arrays:
    return _encode_act(_city_views(job, shard, "val"), encoder)


def _city_views(job: Job, shard: PictureShard, split: str) -> Iterator[CityView]:
    first = shard.index * sources(job)[shard.source].shard
    return cityscapes_views(Path(job.cityscapes), split, shard.count, job.seed, job.config.camera, first=first)


def _encode_act(views: Iterable[LabelledView | CityView], encoder: Encoder) -> Arrays:
    def fields(batch: list[LabelledView | CityView]) -> dict[str, Any]:
        images = np.stack([view.image for view in batch])
        return {
            "tokens": encoder.tokens(images).astype(np.float16),
            "images": resample(images, STUDENT_PX),
            "ray_distance_m": [view.ray_clearance_m for view in batch],
            "ray_dynamic": [view.ray_dynamic for view in batch],
            "scene": scene_numbers(view.scene_hash for view in batch),
        }

    return _join(map(fields, batched(views, BATCH)))


def _masked(job: Job, shard: PictureShard, seed: int, encoder: Encoder) -> Arrays:
    views = masked_views(list(job.families), PURPOSE.split, shard.count, seed, job.config.camera, varied=True)
    return _encode_masked(views, encoder)


def _city_masked(job: Job, shard: PictureShard, seed: int, encoder: Encoder) -> Arrays:
    first, camera = shard.index * sources(job)[shard.source].shard, job.config.camera
    views = cityscapes_masked_views(Path(job.cityscapes), "train", shard.count, job.seed, camera, first=first)
    return _encode_masked(views, encoder)


def _encode_masked(views: Iterable[MaskedView], encoder: Encoder) -> Arrays:
    """Return one row per picture, with `original` -1, and one per mask, with the picture's number as `original`."""

    def fields(number: int, view: MaskedView) -> dict[str, Any]:
        truths: list[MaskedView | Mask] = [view, *view.masks]
        return {
            "tokens": encoder.tokens(
                np.stack([view.image, *(hide(view.image, mask.hidden) for mask in view.masks)])
            ).astype(np.float16),
            "original": [-1] + [number] * len(view.masks),
            "background": [False] + [mask.background for mask in view.masks],
            "ray_distance_m": [truth.ray_distance_m for truth in truths],
            "ray_dynamic": [truth.ray_dynamic for truth in truths],
            "scene": scene_numbers([view.scene_hash] * len(truths)),
        }

    return _join(itertools.starmap(fields, enumerate(views)))


def _described(job: Job, shard: PictureShard, seed: int, encoder: Encoder) -> Arrays:
    purpose = MANIFEST["word-training"]
    views = captioned_views(list(purpose.families), purpose.split, shard.count, seed, job.config.camera, varied=True)

    def fields(batch: list[CaptionedView]) -> dict[str, Any]:
        return {
            "tokens": encoder.tokens(np.stack([view.image for view in batch])).astype(np.float16),
            "cells": [view.cells for view in batch],
            "captions": encoder.embed_texts([view.caption for view in batch]).astype(np.float16),
            "dominant": [view.dominant for view in batch],
            "ground": [view.ground for view in batch],
            "scene": scene_numbers(view.scene_hash for view in batch),
        }

    return _join(map(fields, batched(views, BATCH)))


def scene_numbers(hashes: Iterable[str]) -> np.ndarray:
    """Return a number for each picture, `(N,)` uint64, equal for pictures of the same scene."""
    return np.array([int(text[:16], 16) for text in hashes], np.uint64)


def _join(parts: Iterable[dict[str, Any]]) -> Arrays:
    """Return the arrays of parts, concatenated by name."""
    lists: dict[str, list[np.ndarray]] = {}
    for part in parts:
        for name, rows in part.items():
            lists.setdefault(name, []).append(np.asarray(rows))
    return {name: np.concatenate(rows) for name, rows in lists.items()}
