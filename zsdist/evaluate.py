"""`python -m zsdist.evaluate POLICY`: drives a policy greedily through scenes and says how it did."""

import argparse
import json
import os
import sys
from pathlib import Path

from rich.console import Console

from zsdist import cli, config
from zsdist.errors import RunError, WeightsError
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.report import evaluate
from zsdist.evaluation.workers import Entrant
from zsdist.run.checkpoint import check_vision, load_policy


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = cli.Parser(prog="zsdist.evaluate", description=__doc__)
    parser.add_argument("policy", nargs="?", help="a run directory, a checkpoint, or a baseline (--list names them)")
    parser.add_argument("--list", action="store_true", help="name the baselines and leave")
    parser.add_argument(
        "--scenes", default="test", help="a folder of scene files, a family, or train, validation, test (default: test)"
    )
    parser.add_argument("--episodes", type=cli.count, help="default: every file of a folder, else 50")
    parser.add_argument("--seed", type=cli.natural, default=0, help="which scenes of a family (default: 0)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result there")
    parser.add_argument("--config", type=Path, metavar="FILE", help="world of a baseline; a run brings its own")
    parser.add_argument("--workers", type=cli.count, default=os.cpu_count() or 1, help="processes (default: all cores)")
    return parser


def main(options: argparse.Namespace) -> int:
    """Runs the command; returns its exit status."""
    if options.list:
        for name, baseline in BASELINES.items():
            print(f"{name:16} {baseline.line} (sees {baseline.sees})")
        return 0
    if options.policy is None:
        raise RunError(f"no policy was named; allowed are a run directory, a checkpoint and {', '.join(BASELINES)}")
    entrant, sha256 = find_policy(options.policy, options.config)
    if options.json is not None and (options.json.is_dir() or not options.json.resolve().parent.is_dir()):
        raise RunError(f"--json is {str(options.json)!r}; allowed is a file in a folder that exists")
    report = evaluate(
        entrant,
        policy=options.policy,
        weights_sha256=sha256,
        scenes=options.scenes,
        episodes=options.episodes,
        seed=options.seed,
        workers=options.workers,
    )
    if options.json is not None:
        options.json.write_text(json.dumps(report.result, indent=1, allow_nan=False) + "\n")
    report.show(Console())
    return 0


def find_policy(name: str, config_file: Path | None = None) -> tuple[Entrant, str | None]:
    """Who is meant by a POLICY argument, and the hash of its weights (None for a baseline).

    Raises:
        WeightsError: it is neither a baseline nor a place with weights, or was trained on another encoder than is here.
        ConfigError: the configuration file is wrong.
    """
    if name in BASELINES:
        return Entrant(config.load(config_file), baseline=name), None
    if config_file is not None:
        raise RunError(f"--config {config_file}: a learned policy brings its own configuration; leave the option out")
    if not Path(name).exists():
        raise WeightsError(
            f"policy {name!r} is no folder; allowed are a run directory, a checkpoint and {', '.join(BASELINES)}"
        )
    policy = load_policy(Path(name))
    if note := check_vision(policy):
        print(note, file=sys.stderr)
    return Entrant(policy.config, policy.parameters), policy.sha256


if __name__ == "__main__":
    cli.execute(main, make_parser())
