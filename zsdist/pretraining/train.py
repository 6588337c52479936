"""Pretraining from the first picture to the weights, in one session or several."""

import math
import shutil
from pathlib import Path
from typing import Any

import torch

from zsdist import __version__
from zsdist.common.allowed_resources import allowed_cores
from zsdist.pretraining.job import JOB_FILE, Job
from zsdist.pretraining.pictures import Pictures, disk_bytes, make_all
from zsdist.pretraining.progress import PretrainingProgress
from zsdist.pretraining.stages import Budget, Stages, best_epochs
from zsdist.vision import weights_folder
from zsdist.vision.encoders.base import Encoder
from zsdist.vision.weights_folder import CAMERA_KEYS


def train(
    job: Job,
    folder: Path,
    encoder: Encoder,
    minutes: float,
    workers: int,
    keep_pictures: bool,
    progress: PretrainingProgress,
) -> None:
    """Complete a pretraining and turn its folder into a weights folder.

    Args:
        job: settings of the pretraining.
        folder: folder of the pretraining, made by `job.create`.
        encoder: encoder of the pictures.
        minutes: most minutes that this session may take.
        workers: number of processes that make pictures.
        keep_pictures: whether to keep the pictures at the end.
        progress: display of the progress.

    Raises:
        ZsdistError: the time is too short for the pictures, or a file cannot be written.
    """
    torch.set_num_threads(min(torch.get_num_threads(), allowed_cores()))  # torch does not know a container's quota
    budget = Budget(minutes * 60, ["pictures", *job.stages])
    picture_folder = folder / "pictures"
    space = f"{disk_bytes(job, encoder) / 1e9:.2f} GB of disk"
    limit = "" if math.isinf(minutes) else f", at most {minutes:g} minutes"
    stages = ", ".join(job.stages)
    progress.log(f"{job.images} pictures to train {stages}, made by {workers} processes; {space}{limit}")
    time_used = budget.begin("pictures")
    make_all(job, picture_folder, workers, lambda: time_used() < 1.0, progress.pictures)
    pictures = Pictures(job, picture_folder)
    files = Stages(job, folder, pictures, encoder, budget, progress, workers).run()
    made = weights_folder.write(folder, files, _metadata(job, folder, pictures, encoder))
    for name, digest in made.metadata["files"].items():
        progress.log(f"{folder / name}: SHA-256 {digest[:16]}")
    (folder / JOB_FILE).unlink()  # first: with only a part of the rest it cannot be resumed
    shutil.rmtree(folder / "stages")
    if not keep_pictures:
        shutil.rmtree(picture_folder)


def _metadata(job: Job, folder: Path, pictures: Pictures, encoder: Encoder) -> dict[str, Any]:
    """Return the metadata of the finished weights folder."""
    text_tower = {"text_sha256": encoder.text_sha256} if "words" in job.stages else {}
    return {
        "encoder": {"name": encoder.name, "sha256": encoder.sha256, **text_tower},
        "camera": {key: getattr(job.config.camera, key) for key in CAMERA_KEYS},
        "command": job.command,
        "zsdist": __version__,
        "seed": job.seed,
        "families": list(job.families),
        **pictures.counts(),
        "best": best_epochs(folder / weights_folder.HISTORY_FILE),
    }
