"""`python -m zsdist.launch`: trains, shows how it goes, evaluates, and leaves a run directory behind."""

import argparse
import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from rich.console import Console

from zsdist import config
from zsdist.common import cli
from zsdist.config import Config
from zsdist.errors import ConfigError, RunError
from zsdist.reporting import final_evaluation
from zsdist.run import directory, preflight, program
from zsdist.run.program import RunSpec
from zsdist.telemetry.display import Display
from zsdist.vision.fingerprint import VisionIdentity


def main(options: argparse.Namespace) -> int:
    """Trains as the options say; 0 once the work is done, 130 where it was interrupted."""
    console = Console()
    spec = _resume(options, console) if options.resume else _start(options, console)
    console.print(f"zsdist run [bold]{spec.folder}[/bold] (seed {spec.config.seed})", highlight=False, soft_wrap=True)
    with _interruptible() as interruption:
        summary = _train(spec, interruption, console, prefer_lines=options.plain)
    _check_books(summary)
    _tell_unlearned(summary, spec.config, console)
    final_evaluation.draw_training(spec.folder)
    if summary["ended"] == "interrupted":
        console.print(
            f"interrupted after {summary['episodes']} episodes; everything is saved, go on with\n"
            f"  python -m zsdist.launch --resume {spec.folder}",
            highlight=False,
            soft_wrap=True,
        )
        return cli.INTERRUPTED
    try:
        final_evaluation.compare(spec.folder, spec.config, console)
    except KeyboardInterrupt:
        console.print(
            "the training is complete and saved; only its evaluation was interrupted. To have one:\n"
            f"  python -m zsdist.evaluate {spec.folder}",
            highlight=False,
            soft_wrap=True,
        )
        return cli.INTERRUPTED
    return 0


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    options = cli.Parser(prog="zsdist.launch", description="Train the hierarchical policy with distributed actors.")
    options.add_argument("--actors", type=int, metavar="N", help="actor processes (run.actors)")
    options.add_argument("--episodes", type=int, metavar="N", help="episodes in all, also with --resume (run.episodes)")
    options.add_argument("--seed", type=int, metavar="S", help="of scenes, exploration and initial weights")
    options.add_argument("--config", type=Path, metavar="FILE", help="YAML configuration; see configs/")
    options.add_argument("--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="one setting; repeatable")
    options.add_argument("--single-process", action="store_true", help="all roles in this process, on a virtual clock")
    options.add_argument("--run-dir", type=Path, metavar="DIR", help="folder of the run; default: a new one in runs/")
    options.add_argument(
        "--resume", type=Path, metavar="DIR", help="go on with the run in DIR, and append to its files"
    )
    options.add_argument(
        "--address", metavar="RAY", help="Ray cluster to run on, from one of its nodes: auto or HOST:PORT"
    )
    options.add_argument("--plain", action="store_true", help="progress as lines, also on a terminal")
    return options


def _overrides(options: argparse.Namespace) -> tuple[str, ...]:
    flags = {
        "run.actors": options.actors,
        "run.episodes": options.episodes,
        "seed": options.seed,
        "run.address": options.address,
    }
    overrides = [*options.set, *(f"{key}={json.dumps(value)}" for key, value in flags.items() if value is not None)]
    if options.single_process:
        overrides += ["placement=inline", "transport.kind=memory"]
    return tuple(overrides)


def _start(options: argparse.Namespace, console: Console) -> RunSpec:
    settings = config.load(options.config, _overrides(options))
    vision = _check_parts(settings, console)
    folder = directory.create(options.run_dir, settings).resolve()
    return RunSpec(settings, directory.key_name(folder), folder, {}, vision)


def _resume(options: argparse.Namespace, console: Console) -> RunSpec:
    for name in ("config", "seed", "run_dir"):
        if getattr(options, name) is not None:
            raise ConfigError(
                f"--{name.replace('_', '-')} cannot go with --resume: the run in {options.resume} has its own"
            )
    settings, states = directory.reopen(options.resume, _overrides(options))
    preflight.check_shards(settings, states)
    finished = len(states["scheduler"].meta["finished"])
    # All episodes may be finished, and what follows them not: the last merge, the evaluation.
    over = settings.run.episodes == finished and directory.ended(options.resume) == "complete"
    if settings.run.episodes < finished or over:
        raise RunError(
            f"the run in {options.resume} has finished {finished} episodes and --episodes is {settings.run.episodes}; "
            f"allowed is more than {finished}"
        )
    trained = directory.read_vision(directory.newest_checkpoint(options.resume))
    vision = _check_parts(settings, console)
    if note := trained.check(str(options.resume), vision):
        console.print(note, highlight=False, soft_wrap=True)
    folder = options.resume.resolve()
    directory.rewind(folder, settings, states)
    return RunSpec(settings, directory.key_name(folder), folder, states, vision)


def _check_parts(settings: Config, console: Console) -> VisionIdentity:
    """Finds out before anything is written or started whether scenes, weights, memory and certificates are there."""
    preflight.check_memory(settings)
    preflight.check_certificates(settings)
    console.print("preparing; the first time, this takes about 15 s for what is compiled then", highlight=False)
    return preflight.warm_up(settings)


def _train(spec: RunSpec, interruption: "Interruption", console: Console, *, prefer_lines: bool) -> dict:
    if spec.config.placement == "ray":  # each takes a second or two to import what the other does without
        from zsdist.run import ray as runner
    else:
        from zsdist.run import inline as runner
    epochs = directory.issue_epochs(spec.folder, program.epoch_count(spec.config))
    (spec.folder / "summary.json").unlink(missing_ok=True)
    try:
        with Display(spec.run, console, prefer_lines=prefer_lines) as display:
            runner.run(spec, epochs, interrupted=interruption, watch=display.refresh)
    except RunError as error:
        if not any(spec.folder.glob("checkpoints/*/manifest.json")):
            raise
        raise RunError(f"{error}; go on from the last checkpoint with --resume {spec.folder}") from error
    return json.loads((spec.folder / "summary.json").read_text())


def _check_books(summary: dict) -> None:
    for level, books in summary["transitions"].items():
        if books["produced"] != books["stored"] + books["rejected"]:
            raise RunError(
                f"the books of level {level} do not balance: {books['produced']} transitions produced, "
                f"{books['stored']} stored, {books['rejected']} rejected"
            )


def _tell_unlearned(summary: dict, settings: Config, console: Console) -> None:
    for level, updates in summary["learner_updates"].items():
        if not updates:
            stored, least = summary["transitions"][level]["stored"], getattr(settings, level).min_size
            console.print(
                f"the {level} level has learned nothing: it stored {stored} transitions, and learning starts from "
                f"{least} ({level}.min_size)",
                highlight=False,
                soft_wrap=True,
            )


class Interruption:
    """Whether Ctrl-C was pressed; a second time stops at once, without saving."""

    def __init__(self) -> None:
        self.heard = False

    def __call__(self) -> bool:
        """Whether to stop."""
        return self.heard

    def hear(self, signal_number: int, frame: FrameType | None) -> None:
        """The signal handler."""
        if self.heard:
            raise KeyboardInterrupt
        self.heard = True


@contextmanager
def _interruptible() -> Iterator[Interruption]:
    interruption = Interruption()
    before = {number: signal.signal(number, interruption.hear) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield interruption
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


if __name__ == "__main__":
    cli.execute(main, parser())
