"""`python -m zsdist.sweep FILE.yaml`: train several configurations and seeds, evaluate each, and show one table.

The same command goes on where an earlier one was stopped: finished trials stay, others are resumed.
"""

import argparse
import contextlib
import json
from pathlib import Path

from zsdist.common import atomic_files, cli, commands, locks, output_files, streams
from zsdist.common.allowed_resources import allowed_cores
from zsdist.common.console import PlainConsole
from zsdist.common.signals import Interruption, handled_by
from zsdist.errors import RunError
from zsdist.run import undertaker
from zsdist.sweeping import plan as plans
from zsdist.sweeping import runner
from zsdist.sweeping.folder import TrialFiles


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.sweep", description=__doc__)
    parser.add_argument("file", type=cli.path, metavar="FILE.yaml", help="variants, seeds and evaluation of the sweep")
    folder = "folder of the sweep (default: runs/ and the file's name); an earlier sweep there goes on"
    parser.add_argument("--out", type=cli.path, metavar="DIR", help=folder)
    parser.add_argument("--check", action="store_true", help="check the file and list the trials, then exit")
    return parser


def main(options: argparse.Namespace) -> int:
    """Run the sweep; return 0 when all trials are done, 128 plus its number where a signal interrupted it."""
    console = PlainConsole()
    plan, trials = plans.read(options.file)
    folder = (options.out or Path("runs") / options.file.stem).absolute()
    files = [TrialFiles(folder, plan, trial) for trial in trials]
    at_once = plan.trials_at_once or max(1, allowed_cores() // plan.cores_per_trial)
    if options.check:
        for trial in files:
            console.say(f"{trial.trial.name}: {trial.trial.title}, {'done' if trial.result() else 'not done'}")
        console.say(f"{len(files)} trials, {at_once} at once, in {folder}")
        return 0
    what = f"sweep folder {folder}"
    with output_files.made_folder(what, folder), locks.held(folder, what):
        return _sweep(options, files, at_once, console)


def _sweep(options: argparse.Namespace, files: list[TrialFiles], at_once: int, console: PlainConsole) -> int:
    from zsdist.sweeping import table  # scipy, which no start should wait for

    for trial in files:
        trial.prepare()
    todo, folder = runner.incomplete(files), files[0].folder
    console.say(f"sweep {folder}: {len(todo)} of {len(files)} trials to do, {at_once} at once")
    interruption = Interruption()
    with handled_by(interruption), undertaker.employed() if todo else contextlib.nullcontext():
        failed = runner.run(todo, at_once, interruption, console.say)
    summary = table.summarise(files, failed)
    atomic_files.replace(folder / "summary.json", (json.dumps(summary, indent=1) + "\n").encode())
    atomic_files.replace(folder / "table.md", table.as_markdown(summary).encode())
    table.show(summary, console)
    console.say(f"files: {folder}/table.md and summary.json; outputs of the trials: {folder}/trials")
    again = commands.module("zsdist.sweep", options.file, "--out", folder)
    if interruption():
        streams.tell("interrupted; what the trials have saved is kept. Go on with", f"  {again}")
        return interruption.status
    if failed:
        name, reason = next(iter(failed.items()))
        raise RunError(
            f"{len(failed)} of {len(files)} trials failed, first {name}: {reason}; their outputs are in "
            f"{folder / 'trials'}. Try them again with {again}"
        )
    return 0


if __name__ == "__main__":
    cli.execute(main, make_parser())
