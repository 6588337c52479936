"""Pictures of a pretraining on disk, made in several processes shard by shard, and read back as training data.

A shard is a folder of arrays. It gets its name when it is complete, and name and seed determine its content. So an
existing shard is never made again, and the number of processes has no effect.
"""

import contextlib
import json
import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from zsdist.common import atomic_files, folders
from zsdist.common import process_pool as pool
from zsdist.errors import RunError
from zsdist.pretraining.job import Job
from zsdist.pretraining.rows import Rows
from zsdist.pretraining.sources import Arrays, PictureShard, make, shards, sources
from zsdist.vision.encoders import open_encoder
from zsdist.vision.encoders.base import Encoder
from zsdist.vision.rays import RAYS, ray_angles_rad

if TYPE_CHECKING:
    from zsdist.vision.masks import MaskedExamples
    from zsdist.vision.training.examples import Examples
    from zsdist.vision.training.projection import WordExamples

LIST_FILE = "shards.json"  # list of the shards to train on, written after the last one is made
_SPARE_BYTES = 2**28  # disk space to leave free


def disk_bytes(job: Job, encoder: Encoder) -> int:
    """Return the disk space in bytes of all pictures of a pretraining."""
    return sum(source.pictures * source.picture_bytes(encoder) for source in sources(job).values())


def check_disk(job: Job, encoder: Encoder, folder: Path) -> None:
    """Raise `RunError` unless the disk has space for the pictures that are not made yet."""
    kept = sum(file.stat().st_size for file in folders.visible(folder, "**/*.npy"))
    existing = next(path for path in (folder.resolve(), *folder.resolve().parents) if path.exists())
    need, free = disk_bytes(job, encoder) - kept + _SPARE_BYTES, shutil.disk_usage(existing).free
    if need > free:
        raise RunError(
            f"pictures need {need / 1e9:.1f} GB in {folder}, where {free / 1e9:.1f} GB are free; "
            "allowed are fewer --images or another --out"
        )


def make_all(
    job: Job,
    folder: Path,
    workers: int,
    go_on: Callable[[], bool],
    on_made: Callable[[int, int], None],
) -> None:
    """Make the missing shards, unless an earlier session has written the list of shards.

    Args:
        job: settings of the pretraining.
        folder: folder of the shards.
        workers: number of processes.
        go_on: function that is called before a shard is begun; once it returns false, no further shard is made.
        on_made: function that is called with the number of pictures made and the number planned.

    Raises:
        RunError: a source has no shard, or a worker died.
    """
    if (folder / LIST_FILE).exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    for unfinished in filter(Path.is_dir, folders.visible(folder, "*.new")):
        shutil.rmtree(unfinished)
    wanted = shards(sources(job))
    missing = [shard for shard in wanted if not (folder / shard.name).exists()]
    planned = sum(shard.count for shard in wanted)
    made = planned - sum(shard.count for shard in missing)
    on_made(made, planned)
    counts = pool.each(_make, missing, min(workers, len(missing)), _begin, (job, folder), go_on)
    with contextlib.closing(counts):
        for count in counts:
            made += count
            on_made(made, planned)
    names = [shard.name for shard in wanted if (folder / shard.name).exists()]
    for source in sources(job):
        if not any(_source_of(name) == source for name in names):
            raise RunError(f"the time was too short for pictures of {source!r}; allowed are more --minutes")
    atomic_files.replace(folder / LIST_FILE, json.dumps(names).encode())


class _Worker:
    """State of a worker process that makes shards."""

    job: Job
    folder: Path
    encoder: Encoder


def _begin(job: Job, folder: Path) -> None:
    _Worker.job, _Worker.folder, _Worker.encoder = job, folder, open_encoder(job.config.vision.encoder)


def _make(shard: PictureShard) -> int:
    save(_Worker.folder / shard.name, make(_Worker.job, shard, _Worker.encoder))
    return shard.count


def save(path: Path, arrays: Arrays) -> None:
    """Write a shard; it gets its name when all of it is on the disk."""
    unfinished = path.with_name(f"{path.name}.new")
    unfinished.mkdir()
    for name, array in arrays.items():
        with (unfinished / f"{name}.npy").open("wb") as file:
            np.save(file, array)
            file.flush()
            os.fsync(file.fileno())
    unfinished.rename(path)


class Pictures:
    """Training data from a folder of shards with their list; large arrays stay on the disk.

    Args:
        job: settings of the pretraining.
        folder: folder of the shards.
    """

    def __init__(self, job: Job, folder: Path) -> None:
        self._folder = folder
        self._names = json.loads((folder / LIST_FILE).read_text(encoding="utf-8"))
        self._angles = ray_angles_rad(RAYS, math.radians(job.config.camera.field_of_view_deg))

    def examples(self) -> "Examples":
        """Return the examples that head and student learn from."""
        return self._examples(self._rows("act"))

    def validation(self) -> "Examples":
        """Return the examples for early stopping and calibration; none is from a scene that is trained on."""
        kept = self._new_scenes("validation", "act", "masked")
        return self._examples({name: rows[kept] for name, rows in self._rows("validation").items()})

    def counts(self) -> dict[str, int]:
        """Return the numbers of pictures and scenes for the head, and of masked and captioned pictures."""
        counts: dict[str, int] = {}
        if self._of("act"):
            scene = self._rows("act")["scene"]
            counts |= {"images": len(scene), "scenes": len(np.unique(scene))}
        for source, name in (("masked", "original"), ("described", "scene")):
            if self._of(source):
                counts[f"{source}_images"] = int((np.asarray(self._rows(source)[name]) >= 0).sum())
        return counts

    def masked(self) -> "tuple[Examples, MaskedExamples]":
        """Return unmasked pictures and their masked versions."""
        from zsdist.vision.masks import MaskedExamples

        rows = self._rows("masked")
        indices, offset = [], 0
        for name in self._of("masked"):
            part = np.load(self._folder / name / "original.npy")
            indices.append(np.where(part < 0, part, part + offset))
            offset += int((part < 0).sum())
        original = np.concatenate(indices)  # for each masked version, the index of its unmasked picture among all
        whole, parts = np.flatnonzero(original < 0), np.flatnonzero(original >= 0)
        distance, dynamic = np.asarray(rows["ray_distance_m"]), np.asarray(rows["ray_dynamic"])
        masked = MaskedExamples(
            rows["tokens"][parts], original[parts], distance[parts], dynamic[parts], rows["background"][parts]
        )
        return self._examples({name: array[whole] for name, array in rows.items()}), masked

    def described(self) -> "WordExamples":
        """Return the examples that the projection learns from."""
        return self._words("described", slice(None))

    def described_validation(self) -> "WordExamples":
        """Return the examples for early stopping of the projection."""
        return self._words("described-validation", self._new_scenes("described-validation", "described"))

    def _of(self, *sources: str) -> list[str]:
        """Return the names of the sources' shards, without empty ones, which have no usable photograph."""
        names = [name for name in self._names if _source_of(name) in sources]
        return [name for name in names if folders.visible(self._folder / name)]

    def _rows(self, *sources: str) -> dict[str, Rows]:
        """Return the arrays of sources, by name of the array."""
        names = self._of(*sources)
        if not names:
            raise RunError(f"there is no picture of {' or '.join(sources)}; allowed are one or more")
        fields = [path.stem for path in folders.visible(self._folder / names[0], "*.npy")]
        return {field: Rows.read([self._folder / name / f"{field}.npy" for name in names]) for field in fields}

    def _new_scenes(self, source: str, *trained: str) -> np.ndarray:
        """Return the pictures of a source whose scenes are in none of the sources `trained`, `(N,)` bool."""
        seen = [self._rows(name).get("scene", ()) for name in trained if self._of(name)]
        kept = ~np.isin(np.asarray(self._rows(source)["scene"]), np.concatenate(seen))
        if not kept.any():
            raise RunError(f"no picture of {source!r} is of a scene that is not trained on; allowed are more --images")
        return kept

    def _examples(self, rows: "dict[str, Rows] | dict[str, np.ndarray]") -> "Examples":
        from zsdist.vision.training.examples import Examples

        tokens, images = (cast(np.ndarray, rows.get(name)) for name in ("tokens", "images"))  # `Rows` act like arrays
        distance, dynamic = np.asarray(rows["ray_distance_m"]), np.asarray(rows["ray_dynamic"])
        return Examples(tokens, distance, dynamic, self._angles, images)

    def _words(self, source: str, kept: "slice | np.ndarray") -> "WordExamples":
        from zsdist.vision.training.projection import WordExamples

        rows = self._rows(source)
        return WordExamples(*(rows[name][kept] for name in ("tokens", "cells", "captions", "dominant", "ground")))


def _source_of(name: str) -> str:
    """Return the name of a shard's source."""
    return name.rpartition("-")[0]
