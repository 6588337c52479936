"""A pretraining from its pictures to its weights, in one sitting or in several."""

import math
import shutil
from pathlib import Path
from typing import Any

from zsdist import __version__
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
    watch: PretrainingProgress,
) -> None:
    """Makes what is missing of a pretraining, and leaves a folder of weights.

    Args:
        job: what is to be trained.
        folder: of the pretraining; `job.create` made it.
        encoder: of the pictures.
        minutes: that this sitting may take.
        workers: processes that make pictures.
        keep_pictures: do not remove the pictures at the end.
        watch: is told how far it is.

    Raises:
        ZsdistError: there is no time for the pictures, or a file cannot be written.
    """
    budget = Budget(minutes * 60, ["pictures", *job.stages])
    kept = folder / "pictures"
    room = f"{disk_bytes(job, encoder) / 1e9:.2f} GB of disk"
    limit = "" if math.isinf(minutes) else f", at most {minutes:g} minutes"
    watch.say(f"{job.images} pictures to train {', '.join(job.stages)} on, by {workers} processes; {room}{limit}")
    used = budget.begin("pictures")
    make_all(job, kept, workers, lambda: used() < 1.0, watch.pictures)
    pictures = Pictures(job, kept)
    files = Stages(job, folder, pictures, encoder, budget, watch).run()
    made = weights_folder.write(folder, files, _metadata(job, folder, pictures, encoder))
    for name, digest in made.metadata["files"].items():
        watch.say(f"{folder / name}: SHA-256 {digest[:16]}")
    (folder / JOB_FILE).unlink()  # first: with less than all of the rest nobody could go on
    shutil.rmtree(folder / "stages")
    if not keep_pictures:
        shutil.rmtree(kept)


def _metadata(job: Job, folder: Path, pictures: Pictures, encoder: Encoder) -> dict[str, Any]:
    tower = {"text_sha256": encoder.text_sha256} if "words" in job.stages else {}
    return {
        "encoder": {"name": encoder.name, "sha256": encoder.sha256, **tower},
        "camera": {key: getattr(job.config.camera, key) for key in CAMERA_KEYS},
        "command": job.command,
        "zsdist": __version__,
        "seed": job.seed,
        "families": list(job.families),
        **pictures.counts(),
        "best": best_epochs(folder / weights_folder.HISTORY_FILE),
    }
