"""`python -m zsdist.evaluate POLICY`: drives a policy greedily through scenes and says how it did.

Several policies are taken for training seeds of one method: each is evaluated, then all together. With `--compare`
nothing is driven: two files of episodes are held against each other, scene by scene.
"""

import argparse
import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from zsdist import config
from zsdist.common import cli
from zsdist.errors import RunError, WeightsError
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.comparison import compare
from zsdist.evaluation.contenders import FULL, VARIANTS, Contender
from zsdist.evaluation.drivers import Observability
from zsdist.evaluation.report import Report, evaluate, show_together, together
from zsdist.evaluation.selection import select
from zsdist.run.checkpoint import check_vision, load_policy

SHIPPED = {"pretrained": Path(__file__).parent / "policies" / "pretrained"}  # learned policies in the package, by name


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = cli.Parser(prog="zsdist.evaluate", description=__doc__)
    add = parser.add_argument
    add("policy", nargs="*", help="run directories, checkpoints, pretrained, or a baseline (--list names them)")
    add("--list", action="store_true", help="name the baselines and variants and leave")
    scenes = "a folder of scene files, a family, or train, validation, test (default: test)"
    add("--scenes", default="test", help=scenes)
    add("--episodes", type=cli.count, help="default: every file of a folder, else 50")
    add("--seed", type=cli.natural, default=0, help="which scenes of a family (default: 0)")
    add("--json", type=Path, metavar="FILE", help="write the result there")
    add("--out", type=Path, metavar="FILE.jsonl", help="write each episode there as it ends, one JSON line each")
    add("--resume", action="store_true", help="go on with --out FILE: what it has of the same code and weights stays")
    add("--variant", default=FULL, metavar="NAME", help=f"of a learned policy: {', '.join(VARIANTS)}")
    add("--no-shield", action="store_true", help="drive a learned policy without the shield as well")
    add("--compare", nargs=2, type=Path, metavar="FILE.jsonl", help="paired differences between two files of episodes")
    add("--video", type=Path, metavar="DIR", help="film the first episodes into this folder, MP4 and a still of each")
    add("--video-episodes", type=cli.count, default=3, metavar="N", help="how many of them (default: 3)")
    add("--config", type=Path, metavar="FILE", help="world of a baseline; a run brings its own")
    add("--workers", type=cli.count, default=os.cpu_count() or 1, help="processes (default: all cores)")
    return parser


def main(options: argparse.Namespace) -> int:
    """Runs the command; returns its exit status."""
    console = Console()
    if options.list:
        for name in SHIPPED:
            print(f"{name:24} a learned policy that comes with the package (sees {Observability.CAMERA})")
        for name, baseline in BASELINES.items():
            print(f"{name:24} {baseline.line} (sees {baseline.observability})")
        print("variants of a learned policy, --variant NAME:")
        for name, variant in VARIANTS.items():
            print(f"{name:24} {variant.line}")
        return 0
    _check_json(options.json)
    if options.compare:
        comparison = compare(*options.compare, options.seed)
        _write(options.json, comparison.result)
        comparison.show(console)
        return 0
    if not options.policy:
        raise RunError(f"no policy was named; allowed are a run directory, a checkpoint and {', '.join(BASELINES)}")
    _check_out(options.out, options.resume)
    if options.video is not None and options.video.is_file():
        raise RunError(f"--video {options.video} is a file; allowed is a folder, which is made where it is not there")
    found = [(name, *find_policy(name, options.config, options.variant)) for name in options.policy]
    _check_together(found, options.no_shield)
    reports = []
    for name, contender, sha256 in found:
        reports.append(_drive(options, name, contender, sha256))
        reports[-1].show(console)
        if options.video is not None:
            _film(options, contender, options.video if len(found) == 1 else options.video / Path(name).name)
    if len(reports) == 1:
        _write(options.json, reports[0].result)
        return 0
    result = together(reports, options.seed)
    _write(options.json, result)
    show_together(result, console)
    return 0


def find_policy(name: str, config_file: Path | None = None, variant: str = FULL) -> tuple[Contender, str | None]:
    """Who is meant by a POLICY argument, and the hash of its weights (None for a baseline).

    Raises:
        WeightsError: it is neither a baseline nor a place with weights, or was trained on another encoder than is here.
        ConfigError: the configuration file is wrong.
        RunError: an option does not fit the policy.
    """
    if variant not in VARIANTS:
        raise RunError(f"--variant is {variant!r}; allowed are {', '.join(VARIANTS)}")
    if name in BASELINES:
        if variant != FULL:
            raise RunError(f"--variant {variant}: baseline {name!r} has no variants; allowed is a learned policy")
        return Contender(config.load(config_file), baseline=name), None
    if config_file is not None:
        raise RunError(f"--config {config_file}: a learned policy brings its own configuration; leave the option out")
    folder = SHIPPED.get(name, Path(name))
    if not folder.exists():
        known = ", ".join((*SHIPPED, *BASELINES))
        raise WeightsError(f"policy {name!r} is no folder; allowed are a run directory, a checkpoint and {known}")
    policy = load_policy(folder)
    if note := check_vision(policy):
        print(note, file=sys.stderr)
    return Contender(policy.config, policy.parameters, variant=variant), policy.sha256


def _drive(options: argparse.Namespace, name: str, contender: Contender, sha256: str | None) -> Report:
    """The evaluation that was asked for, and beside it, where asked for, the one without the shield."""
    reports = [
        evaluate(
            who,
            policy=name,
            weights_sha256=sha256,
            scenes=options.scenes,
            episodes=options.episodes,
            seed=options.seed,
            workers=options.workers,
            out=options.out,
        )
        for who in (contender, *((replace(contender, shielded=False),) if options.no_shield else ()))
    ]
    return reports[0] if len(reports) == 1 else reports[0].beside(reports[1])


def _film(options: argparse.Namespace, contender: Contender, folder: Path) -> None:
    """Films the first episodes, which are driven once more for it: what was measured was not slowed."""
    from zsdist.reporting.film import film  # imports matplotlib, which an evaluation does without

    scenes = select(options.scenes, contender.config, options.episodes, options.seed)[: options.video_episodes]
    film(contender, scenes, options.seed, folder, lambda file: print(f"film: {file}", flush=True))


def _check_together(found: list[tuple[str, Contender, str | None]], no_shield: bool) -> None:
    """Holds that those named can be evaluated as they were asked for, before the first of them drives."""
    for index, (name, contender, sha256) in enumerate(found):
        if no_shield and contender.baseline:
            raise RunError(f"--no-shield: baseline {name!r} drives one way only; allowed is a learned policy")
        if contender.baseline and len(found) > 1:
            raise RunError(f"several policies are training seeds of one method; baseline {name!r} is allowed alone")
        for other, _, same in found[:index]:
            if same == sha256:
                raise RunError(f"{name} has the weights of {other}; allowed are different training seeds")


def _check_json(file: Path | None) -> None:
    if file is None:
        return
    _check_place("--json", file)
    if not os.access(file if file.exists() else file.resolve().parent, os.W_OK):
        raise RunError(f"--json is {str(file)!r}, which cannot be written; allowed is a file that can")


def _check_out(out: Path | None, resume: bool) -> None:
    if out is None:
        if resume:
            raise RunError("--resume goes on with a file of episodes; allowed is with --out FILE.jsonl")
        return
    _check_place("--out", out)
    if out.exists() and out.stat().st_size and not resume:
        raise RunError(f"--out {out} is there already; allowed are a new file, and --resume to go on with this one")


def _check_place(option: str, file: Path) -> None:
    if file.is_dir() or not file.resolve().parent.is_dir():
        raise RunError(f"{option} is {str(file)!r}; allowed is a file in a folder that exists")


def _write(file: Path | None, result: dict[str, Any]) -> None:
    if file is None:
        return
    try:
        file.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise RunError(f"the result cannot be written to --json {file}: {error.strerror or error}") from error


if __name__ == "__main__":
    cli.execute(main, make_parser())
