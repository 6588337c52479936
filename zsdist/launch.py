"""`python -m zsdist.launch`: train a policy, show progress, evaluate the result, and write a run directory."""

import argparse
import contextlib
import json
import signal
from pathlib import Path

from rich.console import Console

from zsdist import config
from zsdist.common import cli, output_files, streams
from zsdist.common.signals import Interrupted, Interruption, handled_by, status_of
from zsdist.errors import ConfigError
from zsdist.reporting import final_evaluation
from zsdist.run import opening, training
from zsdist.run.program import RunSpec
from zsdist.telemetry.display import Display
from zsdist.transport.base import Transport


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.launch", description="Train the hierarchical policy with distributed actors.")
    add = parser.add_argument
    add("--actors", type=int, metavar="N", help="number of actor processes (run.actors)")
    add("--episodes", type=int, metavar="N", help="training episodes in total, also with --resume (run.episodes)")
    add("--seed", type=int, metavar="S", help="seed of scenes, exploration and initial weights")
    add("--config", type=Path, metavar="FILE", help="YAML configuration; see configs/")
    add("--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change one setting; repeatable")
    add("--single-process", action="store_true", help="run all roles in this process, on a virtual clock")
    add("--run-dir", type=Path, metavar="DIR", help="folder of the run (default: a new one in runs/)")
    add("--resume", type=Path, metavar="DIR", help="resume the run in DIR and append to its files")
    add("--address", metavar="RAY", help="Ray cluster to run on, from one of its nodes: auto or HOST:PORT")
    add("--plain", action="store_true", help="show progress as lines, also on a terminal")
    return parser


def main(options: argparse.Namespace) -> int:
    """Train as the options say; return 0 when the work is done, 128 plus its number where a signal interrupted it."""
    with contextlib.ExitStack() as held:
        return _launch(options, Console(), held)


def _launch(options: argparse.Namespace, console: Console, held: contextlib.ExitStack) -> int:
    spec = _open(options, console, held)
    console.print(f"zsdist run [bold]{spec.folder}[/bold] (seed {spec.config.seed})", highlight=False, soft_wrap=True)
    interruption = Interruption()
    try:
        summary = _train(spec, console, interruption, prefer_lines=options.plain)
    except KeyboardInterrupt:
        if spec.folder.exists():  # it does not where nothing had begun
            streams.tell(
                "stopped at once; what came after the last checkpoint is not saved. Resume with\n"
                f"  python -m zsdist.launch --resume {spec.folder}"
            )
        raise Interrupted(interruption.number or signal.SIGINT) from None  # Ray may have raised it anew
    interrupted = summary["ended"] == "interrupted"
    if interrupted:
        streams.tell(
            f"interrupted after {summary['episodes']} episodes; everything is saved. Resume with\n"
            f"  python -m zsdist.launch --resume {spec.folder}"
        )
    try:
        with output_files.written(f"the training is saved; run directory {spec.folder}"):
            _conclude(spec, summary, console)
            if not interruption():
                final_evaluation.compare(spec.folder, spec.config, console)
                return 0
        status = interruption.status
    except KeyboardInterrupt as error:
        status = status_of(error)
    if not interrupted:
        streams.tell(
            "the training is complete and saved; only its evaluation was interrupted. Evaluate it with\n"
            f"  python -m zsdist.evaluate {spec.folder}"
        )
    return status


def _conclude(spec: RunSpec, summary: training.Summary, console: Console) -> None:
    """Check and draw the training."""
    training.check_accounts(summary)
    for line in training.describe_untrained_levels(summary, spec.config):
        _print(console, line)
    final_evaluation.draw_training(spec.folder)


def _open(options: argparse.Namespace, console: Console, held: contextlib.ExitStack) -> RunSpec:
    def notify(line: str) -> None:
        _print(console, line)

    overrides = _overrides(options)
    if options.resume is None:
        return opening.open_new(config.load(options.config, overrides), options.run_dir, notify, held)
    for name in ("config", "seed", "run_dir"):
        if getattr(options, name) is not None:
            raise ConfigError(
                f"--{name.replace('_', '-')} cannot be combined with --resume: the run in {options.resume} has its own"
            )
    return opening.open_resumed(options.resume, overrides, notify, held)


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


def _train(spec: RunSpec, console: Console, interruption: Interruption, *, prefer_lines: bool) -> training.Summary:
    with handled_by(interruption), Display(spec.run, console, prefer_lines=prefer_lines) as display:
        told = False

        def watch(transport: Transport, now: float) -> None:
            nonlocal told
            display.refresh(transport, now)
            if interruption() and not told:
                told = True
                _print(console, f"{interruption.name}: stopping and saving; a second signal stops at once, unsaved")

        return training.train(spec, interruption, watch)


def _print(console: Console, line: str) -> None:
    console.print(line, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    cli.execute(main, make_parser())
