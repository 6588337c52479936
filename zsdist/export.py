"""`python -m zsdist.export POLICY --out DIR`: export a trained policy as a bundle that runs without the training stack.

With `--check DIR` nothing is exported: the recorded steps of a bundle are replayed, which needs the runner alone.
"""

import argparse
from pathlib import Path

from zsdist import config
from zsdist.common import cli, commands
from zsdist.common.plain_lines import say
from zsdist.errors import RunError
from zsdist.runtime.bundle import Bundle
from zsdist.runtime.parity import ParityResult, check

SECTIONS = ("camera", "vision")  # of settings that may differ from those of the training
STEPS = 200
EPISODE_STEPS = 40  # of a usual episode, for the display of progress


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.export", description=__doc__)
    add = parser.add_argument
    add("policy", nargs="?", help="run directory, checkpoint, or pretrained")
    add("--out", type=cli.path, metavar="DIR", help="folder of the bundle, which is made")
    add("--check", type=cli.path, metavar="DIR", help="replay the recorded steps of the bundle in DIR; export nothing")
    add("--name", help="name of the policy in the bundle (default: that of POLICY)")
    add("--steps", type=cli.count, default=STEPS, help=f"least number of recorded steps (default: {STEPS})")
    episodes = "least number of recorded episodes, each whole (default: as many as the steps take)"
    add("--episodes", type=cli.natural, default=0, help=episodes)
    evaluation = "result of `zsdist evaluate POLICY --json FILE` for the model card; repeatable"
    add("--evaluation", type=cli.path, action="append", default=[], metavar="FILE", help=evaluation)
    parser.add_set()
    return parser


def main(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    if options.check is not None:
        if options.policy is not None or options.out is not None:
            raise RunError("--check replays a bundle and exports nothing; allowed is --check DIR alone")
        _tell(options.check, check(Bundle.load(options.check)))
        return 0
    if options.policy is None or options.out is None:
        raise RunError("a policy and a folder are needed; allowed is: zsdist export POLICY --out DIR")
    overrides = cli.overrides(options)
    _check_overrides(overrides)
    _export(options, overrides)
    return 0


def _export(options: argparse.Namespace, overrides: tuple[str, ...]) -> None:
    # the training stack is imported where it is needed: --check works without it
    from zsdist.common.progress import StepProgress
    from zsdist.exporting.bundles import check_new, export_policy
    from zsdist.run.checkpoint import check_vision
    from zsdist.run.policies import load_by_name

    check_new(options.out)
    policy = load_by_name(options.policy, (), overrides, _note)
    if note := check_vision(policy):
        _note(note)
    name = options.name or Path(options.policy).resolve().name
    about = max(options.steps, EPISODE_STEPS * options.episodes)  # each is recorded, and then checked
    with StepProgress("export", 2 * about) as shown:
        result = export_policy(
            policy,
            name,
            options.out,
            steps=options.steps,
            episodes=options.episodes,
            evaluations=options.evaluation,
            progress=lambda what, done, total: shown.step(what),
        )
    _tell(options.out, result)
    say(f"check it on the robot with: {commands.quoted('zsdist', 'export', '--check', options.out)}")


def _check_overrides(overrides: tuple[str, ...]) -> None:
    for key in (key for override in overrides for key in config.leaves_of(override)):
        if key.partition(".")[0] not in SECTIONS:
            raise RunError(
                f"--set {key}: a bundle holds the policy as it was trained; allowed are settings of "
                f"{' and '.join(SECTIONS)}"
            )


def _tell(folder: Path, result: ParityResult) -> None:
    say(
        f"bundle {folder} passes: the same decisions in all {result.steps} steps of {result.episodes} episodes; values "
        f"differ by {result.difference:.1g} at most"
    )


def _note(line: str) -> None:
    say(line, error=True)


if __name__ == "__main__":
    cli.execute(main, make_parser())
