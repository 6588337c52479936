"""`python -m zsdist.pretrain`: trains the visual-act head on rendered streets (Algorithm 1), or checks a trained one.

With `--check` the model that `vision.weights` names looks at fresh pictures of the wilderness, families that no
training has seen, and is compared with three yardsticks that know less or more than it does.
"""

import argparse
import itertools
import math
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zsdist import __version__, cli
from zsdist import config as configuration
from zsdist.config import CameraConfig, Config
from zsdist.errors import RunError
from zsdist.pretraining.batches import BATCH, batched
from zsdist.pretraining.check import check
from zsdist.sim.manifest import MANIFEST
from zsdist.sim.views import LabelledView, labelled_views
from zsdist.vision.encoders.base import Encoder
from zsdist.vision.encoders.lite0 import EfficientNetLite0
from zsdist.vision.folder import CAMERA_KEYS
from zsdist.vision.rays import RAYS, ray_angles_rad

if TYPE_CHECKING:
    from zsdist.vision.training.examples import Examples

VALIDATION_SHARE = 0.08  # validation pictures for each training picture
PICTURES_SHARE = 0.5  # of the minutes allowed that may go into pictures


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = cli.Parser(prog="zsdist.pretrain", description=__doc__)
    parser.add_argument(
        "--images", type=_count, help="pictures to train on (default: 8000) or to check on (default: 300)"
    )
    parser.add_argument("--epochs", type=_count, default=24, help="passes over them (default: 24)")
    parser.add_argument("--minutes", type=_minutes, default=math.inf, help="hurry so as to be done by then")
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("runs/visual-act"), help="where weights go")
    parser.add_argument("--check", action="store_true", help="check trained weights instead of training")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures of the check there")
    parser.add_argument("--seed", type=_seed, default=0, help="of scenes, places, looks and weights (default: 0)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="camera, and weights to check")
    parser.add_argument("--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change a setting")
    return parser


def main(options: argparse.Namespace) -> int:
    """Runs the command; returns its exit status."""
    config = configuration.load(options.config, tuple(options.set))
    if options.check:
        check(config, options.images or 300, options.seed, options.json)
    else:
        pretrain(config, options)
    return 0


def pretrain(config: Config, options: argparse.Namespace) -> None:
    """Renders and encodes pictures, trains a head on them and writes it with what it was made from and how well it did.

    Raises:
        RunError: the folder cannot be written.
    """
    from zsdist.vision.training import head as training  # imports torch, which a check does not need

    begin, allowed_s = time.monotonic(), options.minutes * 60
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"--out {options.out} cannot be made: {error.strerror or error}") from error
    count, encoder, purpose = options.images or 8000, EfficientNetLite0(), MANIFEST["vision-training"]

    def views(number: int, seed: int) -> Iterator[LabelledView]:
        return labelled_views(list(purpose.families), purpose.split, number, seed, config.camera, varied=True)

    def pictures_left() -> bool:
        return time.monotonic() - begin < PICTURES_SHARE * allowed_s

    examples, scenes = gather(views(count, options.seed), count, encoder, config.camera, pictures_left)
    held_out = math.ceil(VALIDATION_SHARE * len(examples))
    others = (view for view in views(2 * held_out, options.seed + 1) if view.scene_hash not in scenes)
    validation, _ = gather(itertools.islice(others, held_out), held_out, encoder, config.camera, lambda: True)
    head = training.new_head(examples, math.radians(config.camera.field_of_view_deg), options.seed)
    recipe, epochs = training.Recipe(epochs=options.epochs), []
    rng, train_begin = np.random.default_rng([options.seed, 1]), time.monotonic()
    train_s = max(allowed_s - (train_begin - begin), 1.0)
    for figures in training.train(
        head, examples, validation, recipe, rng, lambda: (time.monotonic() - train_begin) / train_s
    ):
        epochs.append(figures)
        print(
            f"epoch {figures['epoch']:3d} of {recipe.epochs}: loss {figures['loss']:.3f}, "
            f"validation {figures['validation_loss']:.3f} (rays {figures['validation_rays']:.3f}), "
            f"{time.monotonic() - begin:.0f} s",
            flush=True,
        )
    best = min(epochs, key=lambda figures: figures["validation_loss"])
    metadata = {
        "encoder": {"name": encoder.name, "sha256": encoder.sha256},
        "camera": {key: getattr(config.camera, key) for key in CAMERA_KEYS},
        "command": shlex.join(["python", "-m", "zsdist.pretrain", *sys.argv[1:]]),
        "zsdist": __version__,
        "seed": options.seed,
        "families": list(purpose.families),
        "images": len(examples),
        "scenes": len(scenes),
        "validation": {key: round(value, 4) for key, value in best.items()},
    }
    digest = training.save(head, options.out, metadata)
    print(
        f"weights {digest[:16]}, of epoch {best['epoch']}, are in {options.out}; use them by --set vision.weights=..."
    )


def gather(
    views: Iterable[LabelledView], count: int, encoder: Encoder, camera: CameraConfig, go_on: Callable[[], bool]
) -> tuple["Examples", set[str]]:
    """Encodes pictures as they come; the pictures themselves are not kept.

    Args:
        views: at most `count` of them.
        count: for how many there is room.
        encoder: of the pictures.
        camera: that took them.
        go_on: asked after each batch.

    Returns:
        What can be trained on, and the hashes of the scenes they are of.
    """
    from zsdist.vision.training.examples import Examples

    angles = ray_angles_rad(RAYS, math.radians(camera.field_of_view_deg))
    distance, dynamic = np.empty((count, RAYS), np.float32), np.empty((count, RAYS), bool)
    tokens, made, scenes = None, 0, set()
    for batch in batched(views, BATCH):
        found = encoder.tokens(np.stack([view.image for view in batch]))
        if tokens is None:
            tokens = np.empty((count, *found.shape[1:]), np.float16)
        rows = slice(made, made + len(batch))
        tokens[rows] = found
        distance[rows] = [view.ray_clearance_m for view in batch]
        dynamic[rows] = [view.ray_dynamic for view in batch]
        scenes |= {view.scene_hash for view in batch}
        made += len(batch)
        if made % (50 * BATCH) == 0:
            print(f"{made} of {count} pictures encoded", flush=True)
        if not go_on():
            break
    return Examples(tokens[:made], distance[:made], dynamic[:made], angles), scenes


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not 1 or more")
    return value


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} is not 0 or more")
    return value


def _minutes(text: str) -> float:
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{value} is not more than 0")
    return value


if __name__ == "__main__":
    cli.execute(main, make_parser())
