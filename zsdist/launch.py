"""`python -m zsdist.launch`: train a policy, show progress, evaluate the result, and write a run directory."""

import argparse

from zsdist import config
from zsdist.common import cli, commands
from zsdist.common.console import PlainConsole
from zsdist.errors import ConfigError
from zsdist.reporting import final_evaluation
from zsdist.run import opening, training
from zsdist.run.interruption import interruptible
from zsdist.run.program import RunSpec
from zsdist.telemetry.display import Display

ONE_PROCESS = ("placement=inline", "transport.kind=memory", "run.address=null")  # `--single-process`


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.launch", description="Train the hierarchical policy with distributed actors.")
    add = parser.add_argument
    setting = parser.add_setting
    setting("--actors", "run.actors", type=int, metavar="N", help="number of actor processes (run.actors)")
    episodes = "training episodes in total, also with --resume (run.episodes)"
    setting("--episodes", "run.episodes", type=int, metavar="N", help=episodes)
    setting("--seed", "seed", type=int, metavar="S", help="seed of scenes, exploration and initial weights")
    add("--config", type=cli.path, metavar="FILE", help="YAML configuration; see configs/")
    parser.add_set()
    setting("--single-process", *ONE_PROCESS, action="store_true", help="run all roles here, on a virtual clock")
    add("--run-dir", type=cli.path, metavar="DIR", help="folder of the run (default: a new one in runs/)")
    add("--resume", type=cli.path, metavar="DIR", help="resume the run in DIR and append to its files")
    address = "Ray cluster to run on, from one of its nodes: auto or HOST:PORT"
    setting("--address", "run.address", metavar="RAY", help=address)
    add("--plain", action="store_true", help="show progress as lines, also on a terminal")
    return parser


def main(options: argparse.Namespace) -> int:
    """Train as the options say; return 0 when the work is done, 130 where it was interrupted."""
    console = PlainConsole()
    spec = _open(options, console)
    console.say("zsdist run ", (str(spec.folder), "bold"), f" (seed {spec.config.seed})")
    summary = _train(spec, console, prefer_lines=options.plain)
    training.check_accounts(summary)
    for line in training.describe_untrained_levels(summary, spec.config, spec.states):
        console.say(line)
    final_evaluation.draw_training(spec.folder)
    if summary["ended"] == "interrupted":
        console.say(f"interrupted after {summary['episodes']} episodes; everything is saved. Resume with")
        shown = commands.repeated(make_parser(), options, ("plain",))
        console.say(f"  {commands.module('zsdist.launch', '--resume', spec.folder, *shown)}")
        return cli.INTERRUPTED
    try:
        final_evaluation.compare(spec.folder, spec.config, console)
    except KeyboardInterrupt:
        console.say("the training is complete and saved; only its evaluation was interrupted. Evaluate it with")
        console.say(f"  {commands.module('zsdist.evaluate', spec.folder)}")
        return cli.INTERRUPTED
    return 0


def _open(options: argparse.Namespace, console: PlainConsole) -> RunSpec:
    overrides = cli.overrides(options)
    if options.resume is None:
        return opening.open_new(config.load(options.config, overrides, console.say), options.run_dir, console.say)
    for name in ("config", "seed", "run_dir"):
        if getattr(options, name) is not None:
            raise ConfigError(
                f"--{name.replace('_', '-')} cannot be combined with --resume: the run in {options.resume} has its own"
            )
    return opening.open_resumed(options.resume, overrides, console.say)


def _train(spec: RunSpec, console: PlainConsole, *, prefer_lines: bool) -> training.Summary:
    with interruptible() as interruption, Display(spec.run, console, prefer_lines=prefer_lines) as display:
        return training.train(spec, interruption, display.refresh)


if __name__ == "__main__":
    cli.execute(main, make_parser())
