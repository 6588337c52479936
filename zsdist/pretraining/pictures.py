"""Pictures of a pretraining on disk: made in several processes, shard by shard, and read back as what is trained on.

Each shard is a folder of arrays that appears under its name when it is whole, and follows from its name and the seed:
what is there is never made again, and the number of processes changes nothing.
"""

import contextlib
import json
import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zsdist.common import atomic_files
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

LIST_FILE = "shards.json"  # those to train on, once no more are to be made
_SPARE_BYTES = 2**28  # left free on the disk


def disk_bytes(job: Job, encoder: Encoder) -> int:
    """What the pictures of a pretraining take on disk."""
    return sum(source.pictures * source.bytes_each(encoder) for source in sources(job).values())


def check_disk(job: Job, encoder: Encoder, folder: Path) -> None:
    """Raises `RunError` unless there is room for the pictures that are not made yet."""
    kept = sum(file.stat().st_size for file in folder.rglob("*.npy"))
    there = next(place for place in (folder.resolve(), *folder.resolve().parents) if place.exists())
    need, free = disk_bytes(job, encoder) - kept + _SPARE_BYTES, shutil.disk_usage(there).free
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
    """Makes the shards that are missing, unless the list of them was closed by an earlier sitting.

    Args:
        job: what is to be trained.
        folder: of the shards.
        workers: processes.
        go_on: asked before a shard is begun; where it says no, what is there is all that will be.
        on_made: called with the pictures that are there and those that are planned.

    Raises:
        RunError: so little is there that some source has no shard, or a worker died.
    """
    if (folder / LIST_FILE).exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    for left in folder.glob("*.new"):
        shutil.rmtree(left)
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
    there = [shard.name for shard in wanted if (folder / shard.name).exists()]
    for source in sources(job):
        if not any(_source_of(name) == source for name in there):
            raise RunError(f"there was no time for pictures of {source!r}; allowed are more --minutes")
    atomic_files.replace(folder / LIST_FILE, json.dumps(there).encode())


class _Worker:
    """What a process that makes shards holds."""

    job: Job
    folder: Path
    encoder: Encoder


def _begin(job: Job, folder: Path) -> None:
    _Worker.job, _Worker.folder, _Worker.encoder = job, folder, open_encoder(job.config.vision.encoder)


def _make(shard: PictureShard) -> int:
    save(_Worker.folder / shard.name, make(_Worker.job, shard, _Worker.encoder))
    return shard.count


def save(path: Path, arrays: Arrays) -> None:
    """Writes a shard, which takes its name when all of it is on the disk."""
    new = path.with_name(f"{path.name}.new")
    new.mkdir()
    for name, array in arrays.items():
        with (new / f"{name}.npy").open("wb") as file:
            np.save(file, array)
            file.flush()
            os.fsync(file.fileno())
    new.rename(path)


class Pictures:
    """The pictures in a folder whose list is closed, as what is trained on; large arrays stay on the disk."""

    def __init__(self, job: Job, folder: Path) -> None:
        self._folder = folder
        self._names = json.loads((folder / LIST_FILE).read_text())
        self._angles = ray_angles_rad(RAYS, math.radians(job.config.camera.field_of_view_deg))

    def examples(self) -> "Examples":
        """What head and student learn from."""
        return self._examples(self._rows("act"))

    def validation(self) -> "Examples":
        """By which is decided when to stop, and how wide the distributions should be; no scene is trained on."""
        kept = self._new_scenes("validation", "act", "masked")
        return self._examples({name: rows[kept] for name, rows in self._rows("validation").items()})

    def counts(self) -> dict[str, int]:
        """Of what was trained on: pictures and different scenes for the head, masked and described pictures."""
        found = {}
        if self._of("act"):
            scene = self._rows("act")["scene"]
            found |= {"images": len(scene), "scenes": len(np.unique(scene))}
        for source, name in (("masked", "original"), ("described", "scene")):
            if self._of(source):
                found[f"{source}_images"] = int((np.asarray(self._rows(source)[name]) >= 0).sum())
        return found

    def masked(self) -> "tuple[Examples, MaskedExamples]":
        """Originals and their masked versions."""
        from zsdist.vision.masks import MaskedExamples

        rows = self._rows("masked")
        numbers, offset = [], 0
        for name in self._of("masked"):
            part = np.load(self._folder / name / "original.npy")
            numbers.append(np.where(part < 0, part, part + offset))
            offset += int((part < 0).sum())
        original = np.concatenate(numbers)
        whole, parts = np.flatnonzero(original < 0), np.flatnonzero(original >= 0)
        distance, dynamic = np.asarray(rows["ray_distance_m"]), np.asarray(rows["ray_dynamic"])
        masked = MaskedExamples(
            rows["tokens"][parts], original[parts], distance[parts], dynamic[parts], rows["background"][parts]
        )
        return self._examples({name: array[whole] for name, array in rows.items()}), masked

    def described(self) -> "WordExamples":
        """What the projection learns from."""
        return self._words("described", slice(None))

    def described_validation(self) -> "WordExamples":
        """By which is decided when to stop learning words."""
        return self._words("described-validation", self._new_scenes("described-validation", "described"))

    def _of(self, *sources: str) -> list[str]:
        """Shards of sources; one of photographs is empty where nobody labelled enough of any."""
        names = [name for name in self._names if _source_of(name) in sources]
        return [name for name in names if any((self._folder / name).iterdir())]

    def _rows(self, *sources: str) -> dict[str, Rows]:
        names = self._of(*sources)
        if not names:
            raise RunError(f"there is not one picture of {' or '.join(sources)}; allowed are one or more")
        fields = sorted(path.stem for path in (self._folder / names[0]).glob("*.npy"))
        return {field: Rows.read([self._folder / name / f"{field}.npy" for name in names]) for field in fields}

    def _new_scenes(self, source: str, *trained: str) -> np.ndarray:
        """Which pictures of a source `(N,)` bool are of scenes that none of `trained` has."""
        learned = [self._rows(name).get("scene", ()) for name in trained if self._of(name)]
        kept = ~np.isin(np.asarray(self._rows(source)["scene"]), np.concatenate(learned))
        if not kept.any():
            raise RunError(f"no picture of {source!r} is of a scene that is not trained on; allowed are more --images")
        return kept

    def _examples(self, rows: "dict[str, Rows] | dict[str, np.ndarray]") -> "Examples":
        from zsdist.vision.training.examples import Examples

        distance, dynamic = np.asarray(rows["ray_distance_m"]), np.asarray(rows["ray_dynamic"])
        return Examples(rows["tokens"], distance, dynamic, self._angles, rows.get("images"))

    def _words(self, source: str, kept: "slice | np.ndarray") -> "WordExamples":
        from zsdist.vision.training.projection import WordExamples

        rows = self._rows(source)
        return WordExamples(*(rows[name][kept] for name in ("tokens", "cells", "captions", "dominant", "ground")))


def _source_of(name: str) -> str:
    return name.rpartition("-")[0]
