"""`python -m zsdist.pretrain`: train the vision of the car (Algorithm 1), or check a trained one.

Pictures are rendered and encoded first; then the projection to words, the head and the small student network are
trained on them, and the compact network on pictures that are made meanwhile. Finished parts are kept: after Ctrl-C or
SIGTERM, `--resume DIR` resumes. With `--check`, the model of `vision.weights` is evaluated on fresh pictures of
families that are withheld from training, beside baselines that know less or more.
"""

import argparse
import contextlib
import math
import sys
from pathlib import Path

from zsdist import config as configuration
from zsdist.common import cli, commands, locks, output_files, places, signals, streams
from zsdist.common.console import say
from zsdist.config import Config
from zsdist.errors import ConfigError
from zsdist.pretraining import job as jobs
from zsdist.pretraining.check.check import OBJECTS, check
from zsdist.pretraining.job import PURPOSE, STAGES, Job
from zsdist.pretraining.pictures import check_disk
from zsdist.pretraining.progress import PretrainingProgress
from zsdist.vision.encoders import open_encoder
from zsdist.vision.models import COMPACT_PX

IMAGES = 30_000
CHECK_IMAGES = 300
NOT_KEPT = ("minutes", "workers", "keep-pictures", "json", "plain")  # options that a pretraining's folder lacks


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.pretrain", description=__doc__)
    add = parser.add_argument
    images = f"number of pictures to train the head on ({IMAGES}), or to check on ({CHECK_IMAGES})"
    add("--images", type=cli.count, metavar="N", help=images)
    add("--epochs", type=cli.count, metavar="N", help="epochs of every stage (default: each stage's own)")
    add(
        "--minutes",
        type=_minutes,
        default=math.inf,
        metavar="M",
        help="time limit; cuts pictures and epochs short",
    )
    add("--out", type=cli.path, metavar="DIR", help="folder of the weights (default: runs/visual-act)")
    add("--resume", type=cli.path, metavar="DIR", help="resume the pretraining in DIR")
    add("--families", metavar="A,B", help=f"scene families of the pictures (default: {','.join(PURPOSE.families)})")
    add("--cityscapes", type=cli.path, metavar="DIR", help="train on the photographs in DIR instead of on scenes")
    add("--stages", metavar="A,B", help=f"parts to train (default: {','.join(STAGES)})")
    encoder = "vision.encoder: efficientnet-lite0, or a folder with a CLIP model"
    parser.add_setting("--encoder", "vision.encoder", metavar="NAME|DIR", help=encoder)
    parser.add_workers()
    add("--keep-pictures", action="store_true", help="keep the pictures when training has ended")
    add("--check", action="store_true", help="check trained weights instead of training")
    add("--json", type=cli.path, metavar="FILE", help="write the figures of the check to FILE")
    add(
        "--objects",
        type=cli.natural,
        default=OBJECTS,
        metavar="N",
        help=f"objects to drive to in a check ({OBJECTS})",
    )
    add(
        "--objects-file",
        type=cli.path,
        metavar="FILE",
        help="record of each object, from which a check resumes",
    )
    add("--unseen-kinds", action="store_true", help="also check words for kinds that the projection was not trained on")
    seed = "seed of scenes, poses, appearance and weights (default: 0)"
    parser.add_setting("--seed", "seed", type=cli.natural, metavar="S", help=seed)
    add("--config", type=cli.configuration, metavar="FILE", help="preset or file: camera, encoder, weights to check")
    parser.add_set()
    add("--plain", action="store_true", help="show progress as lines, also on a terminal")
    return parser


def main(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    if not options.check:
        return pretrain(options)
    with contextlib.ExitStack() as held:
        for option, file in (("--json", options.json), ("--objects-file", options.objects_file)):
            if file is not None:
                output_files.check_place(option, file)
                held.enter_context(locks.held(file, f"{option} {file}"))
        config = _config(options)
        check(
            config,
            options.images or CHECK_IMAGES,
            config.seed,
            options.json,
            options.objects,
            options.objects_file,
            options.unseen_kinds,
        )
    return 0


def pretrain(options: argparse.Namespace) -> int:
    """Train and then check the result; return 128 plus its number where a signal interrupted it.

    Raises:
        ZsdistError: an option, the folder or the encoder cannot be used.
    """
    if options.resume is not None and options.resume.is_file():  # a file of the pretraining
        options.resume = options.resume.parent
    folder = options.resume or options.out or Path("runs/visual-act")
    with contextlib.ExitStack() as held:
        if options.json is not None:
            output_files.check_place("--json", options.json)
            held.enter_context(locks.held(options.json, f"--json {options.json}"))
        return _pretrain(options, folder, held)


def _pretrain(options: argparse.Namespace, folder: Path, held: contextlib.ExitStack) -> int:
    from zsdist.pretraining.train import train  # imports torch, which a check does not need

    job = _reopened(options) if options.resume else _new(options)
    encoder = open_encoder(job.config.vision.encoder)
    check_disk(job, encoder, folder)

    def lock(made: Path) -> None:
        held.enter_context(locks.held(made, f"pretraining {made}"))

    if options.resume:
        lock(folder)
        job = _reopened(options)  # again: another process may have finished it meanwhile
    else:
        jobs.create(folder, job, lock)
    try:
        with (
            PretrainingProgress(prefer_lines=options.plain) as watch,
            output_files.written(f"pretraining {folder}"),
        ):
            train(job, folder, encoder, options.minutes, options.workers, options.keep_pictures, watch)
    except KeyboardInterrupt as error:
        again = commands.repeated(make_parser(), options, NOT_KEPT)
        streams.tell(
            "interrupted; finished parts are kept. Resume with",
            f"  {commands.module('zsdist.pretrain', '--resume', folder, *again)}",
        )
        return signals.status_of(error)
    network = next((stage for stage in ("head", "compact") if stage in job.stages), None)
    if network is not None:
        vision = job.config.vision.model_copy(update={"weights": str(folder.absolute()), "network": network})
        camera = job.config.camera.model_copy(update={"size_px": COMPACT_PX} if network == "compact" else {})
        config = job.config.model_copy(update={"vision": vision, "camera": camera})
        check(config, CHECK_IMAGES, job.seed, options.json, object_count=0)
    use = commands.quoted("--set", f"vision.weights={folder.resolve()}")
    say(f"weights are in {folder}; use them with {use}")
    return 0


def _new(options: argparse.Namespace) -> Job:
    if options.cityscapes and options.families:
        raise ConfigError("--families cannot be combined with --cityscapes, which uses photographs instead of scenes")
    families = () if options.cityscapes else _names(options.families, PURPOSE.families)
    jobs.check_families(families)
    stages = _names(options.stages, STAGES)
    jobs.check_stages(stages)
    config = _config(options)
    return Job(
        images=options.images or IMAGES,
        epochs=options.epochs or 0,
        seed=config.seed,
        families=families,
        cityscapes=places.absolute(str(options.cityscapes)) if options.cityscapes else "",
        stages=tuple(stage for stage in STAGES if stage in stages),
        config=config,
        command=commands.quoted("python", "-m", "zsdist.pretrain", *sys.argv[1:]),
    )


def _reopened(options: argparse.Namespace) -> Job:
    own = ("images", "epochs", "out", "families", "cityscapes", "stages", "encoder", "seed", "config", "set")
    for name in own:
        if getattr(options, name) not in (None, []):
            raise ConfigError(
                f"--{name} cannot be combined with --resume: the pretraining in {options.resume} has its own"
            )
    return jobs.reopen(options.resume)


def _config(options: argparse.Namespace) -> Config:
    return configuration.load(options.config, cli.overrides(options), lambda line: say(line, error=True))


def _names(text: str | None, default: tuple[str, ...]) -> tuple[str, ...]:
    return default if text is None else tuple(name.strip() for name in text.split(","))


def _minutes(text: str) -> float:
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{value} is not more than 0")
    return value


if __name__ == "__main__":
    cli.execute(main, make_parser())
