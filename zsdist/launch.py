"""`python -m zsdist.launch`: train a policy, show progress, evaluate the result, and write a run directory."""

import argparse
import contextlib
import signal
import time
from dataclasses import replace

from zsdist import config
from zsdist.common import cli, commands, output_files, presets, streams
from zsdist.common.console import PlainConsole
from zsdist.common.signals import Interrupted, Interruption, handled_by, status_of
from zsdist.errors import CompleteError, ConfigError
from zsdist.roles import permissions
from zsdist.run import location, opening, preflight, program, training
from zsdist.run.program import RunSpec
from zsdist.telemetry import history
from zsdist.telemetry.curves import CurveHistory
from zsdist.telemetry.display import Display
from zsdist.transport.base import Transport


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.launch", description="Train the hierarchical policy with distributed actors.")
    add = parser.add_argument
    setting = parser.add_setting
    setting("--actors", "run.actors", type=cli.whole, metavar="N", help="number of actor processes (run.actors)")
    episodes = "training episodes in total, also with --resume (run.episodes)"
    setting("--episodes", "run.episodes", type=cli.whole, metavar="N", help=episodes)
    setting("--seed", "seed", type=cli.whole, metavar="S", help="seed of scenes, exploration and initial weights")
    preset = f"YAML configuration, or a preset: {', '.join(presets.names())}"
    add("--config", type=cli.configuration, metavar="FILE", help=preset)
    parser.add_set()
    setting("--single-process", *config.ONE_PROCESS, action="store_true", help="run all roles here, on a virtual clock")
    add("--run-dir", type=cli.path, metavar="DIR", help="folder of the run (default: a new one in runs/)")
    add("--resume", type=cli.path, metavar="DIR", help="resume the run in DIR and append to its files")
    again = "with --run-dir DIR: resume the run in DIR where there is one, and do nothing where it is complete"
    add("--auto-resume", action="store_true", help=again)
    address = "Ray cluster to run on, from one of its nodes: auto or HOST:PORT"
    setting("--address", "run.address", metavar="RAY", help=address)
    add(
        "--join",
        metavar="ENDPOINT",
        help="add --actors N actors to the run whose hub is at ENDPOINT, from this machine",
    )
    tls = "folder with certificates, for a hub that asks for them (transport.tls)"
    setting("--tls", "transport.tls", type=cli.path, metavar="DIR", help=tls)
    profile = "write where the time of each role goes into the run directory; zsdist.report draws it"
    add("--profile", action="store_true", help=profile)
    add("--plain", action="store_true", help="show progress as lines, also on a terminal")
    return parser


def main(options: argparse.Namespace) -> int:
    """Train as the options say; return 0 when the work is done, 128 plus its number where a signal interrupted it."""
    if options.join is not None:
        return _join(options, PlainConsole())
    with contextlib.ExitStack() as held:
        return _launch(options, PlainConsole(), held)


def _launch(options: argparse.Namespace, console: PlainConsole, held: contextlib.ExitStack) -> int:
    try:
        spec = replace(_open(options, console, held), profile=options.profile)
    except CompleteError as error:
        if not options.auto_resume:
            raise
        console.say(f"nothing is left to do: {error}")
        return 0
    console.say("zsdist run ", (str(spec.folder), "bold"), f" (seed {spec.config.seed})")
    shown = commands.repeated(make_parser(), options, ("plain", "profile"))
    resume = f"  {commands.module('zsdist.launch', '--resume', spec.folder, *shown)}"
    interruption = Interruption()
    try:
        summary = _train(spec, console, interruption, prefer_lines=options.plain)
    except KeyboardInterrupt as error:
        if reason := str(error):
            streams.tell(f"{reason}; the run did not wait for it")
        if spec.folder.exists():  # it does not where nothing had begun
            streams.tell("stopped at once; what came after the last checkpoint is not saved. Resume with", resume)
        raise Interrupted(interruption.number or signal.SIGINT) from None  # Ray may have raised it anew
    interrupted = summary["ended"] == "interrupted"
    if interrupted:
        streams.tell(f"interrupted after {summary['episodes']} episodes; {_saved(summary)}. Resume with", resume)
    else:
        console.say("the training has ended and is saved; its figures are drawn, and its evaluation follows")
    try:
        with output_files.written(f"the training is saved; run directory {spec.folder}"):
            _conclude(spec, summary, console)
            if not interruption():
                from zsdist.reporting import final_evaluation

                final_evaluation.compare(spec.folder, spec.config, console)
                return 0
        status = interruption.status
    except KeyboardInterrupt as error:
        status = status_of(error)
    if not interrupted:
        streams.tell(
            "the training is complete and saved; only its evaluation was interrupted. Evaluate it with",
            f"  {commands.module('zsdist.evaluate', spec.folder)}",
        )
    return status


def _saved(summary: training.Summary) -> str:
    """Return what an interruption has saved, as part of a sentence."""
    if "driven_again" not in summary:
        return "everything is saved"
    return f"everything until there is saved, and what came after ({summary['driven_again']} begun) is driven again"


def _conclude(spec: RunSpec, summary: training.Summary, console: PlainConsole) -> None:
    """Check and draw the training."""
    from zsdist.reporting import final_evaluation  # matplotlib and scipy: 3 s that no start should wait for

    training.check_accounts(summary)
    for line in (
        *training.describe_losses(summary),
        *training.describe_untrained_levels(summary, spec.config, spec.states),
    ):
        console.say(line)
    final_evaluation.draw_training(spec.folder)


def _open(options: argparse.Namespace, console: PlainConsole, held: contextlib.ExitStack) -> RunSpec:
    overrides = cli.overrides(options)
    if options.auto_resume and (options.run_dir is None or options.resume is not None):
        raise ConfigError("--auto-resume needs --run-dir DIR, in which it looks for a run, and no --resume")
    if options.auto_resume and (options.run_dir / location.CONFIG_FILE).is_file():
        return opening.open_resumed(options.run_dir, overrides, console.say, held)
    if options.resume is None:
        settings = config.load(options.config, overrides, console.say)
        preflight.check_used(settings, overrides)
        return opening.open_new(settings, options.run_dir, console.say, held)
    for name in ("config", "seed", "run_dir"):
        if getattr(options, name) is not None:
            raise ConfigError(
                f"--{name.replace('_', '-')} cannot be combined with --resume: the run in {options.resume} has its own"
            )
    return opening.open_resumed(options.resume, overrides, console.say, held)


def _join(options: argparse.Namespace, console: PlainConsole) -> int:
    """Add actors to a run elsewhere until it ends; return 128 plus its number where a signal has taken them away."""
    from zsdist.run import join

    for name in ("config", "episodes", "seed", "single_process", "run_dir", "resume", "auto_resume", "address"):
        value = getattr(options, name)
        if value is not None and value is not False:
            option = f"--{name.replace('_', '-')}"
            raise ConfigError(f"{option} cannot be combined with --join: the run at {options.join} has its own")
    for override in options.set:
        for key in config.leaves_of(override):
            if key not in join.LOCAL_SETTINGS:
                raise ConfigError(
                    f"--set {key} cannot be combined with --join: the run at {options.join} has its own settings; "
                    f"allowed are {', '.join(join.LOCAL_SETTINGS)}"
                )
    actors = 1 if options.actors is None else options.actors
    if not 1 <= actors <= permissions.MAX_ACTORS:
        raise ConfigError(f"--actors is {actors}; allowed is 1 to {permissions.MAX_ACTORS}")
    interruption = Interruption()
    with handled_by(interruption):
        party = join.Party(options.join, options.tls, actors, options.set, console.say)
        party.take_part(interruption)
    return interruption.status if interruption() else 0


def _train(spec: RunSpec, console: PlainConsole, interruption: Interruption, *, prefer_lines: bool) -> training.Summary:
    display = Display(
        spec.run,
        console,
        title=spec.folder.resolve().name,
        prefer_lines=prefer_lines,
        started_s=time.time(),
        expected=program.reporting(spec.config),
        history=CurveHistory(history.curves(spec.folder)),
    )
    with handled_by(interruption), display:
        display.show()  # nothing is received before Ray and the hub have started
        told = False

        def watch(transport: Transport, now: float) -> None:
            nonlocal told
            display.refresh(transport, now)
            if interruption() and not told:
                told = True
                display.tell(f"{interruption.name}: stopping and saving; a second signal stops at once, unsaved")

        return training.train(spec, interruption, watch)


if __name__ == "__main__":
    cli.execute(main, make_parser())
