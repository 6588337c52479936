"""`python -m zsdist.evaluate POLICY`: drive a policy greedily through scenes and report how it did.

Several policies are taken as training seeds of one method: each is evaluated, then all are summarised together. With
`--compare` nothing is driven: two files of episodes are compared scene by scene.
"""

import argparse
import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

from zsdist import config
from zsdist.common import cli, commands, locks, output_files, places, streams
from zsdist.common.console import PlainConsole, say
from zsdist.errors import RunError
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.comparison import compare
from zsdist.evaluation.contenders import FULL, VARIANTS, Contender
from zsdist.evaluation.drivers import Observability
from zsdist.evaluation.fingerprint import SECTIONS
from zsdist.evaluation.policies import NamedPolicy, check_together
from zsdist.evaluation.report import Report, evaluate, show_together, together
from zsdist.evaluation.selection import BUILT_IN, select
from zsdist.run.checkpoint import check_vision
from zsdist.run.policies import SHIPPED, load_by_name


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.evaluate", description=__doc__)
    add = parser.add_argument
    add("policy", nargs="*", help="run directories, checkpoints, pretrained, or a baseline (see --list)")
    add("--list", action="store_true", help="list the baselines and variants, then exit")
    scenes = "a folder of scene files, a family, or train, validation, test (default: test)"
    add("--scenes", default="test", help=scenes)
    add("--episodes", type=cli.count, help="number of episodes (default: every file of a folder, else 50)")
    add("--seed", type=cli.natural, default=0, help="seed that selects the scenes of a family (default: 0)")
    add("--json", type=cli.path, metavar="FILE", help="write the result to FILE")
    add("--out", type=cli.path, metavar="FILE.jsonl", help="append each episode to FILE as it ends, as one JSON line")
    add("--resume", action="store_true", help="resume --out FILE: keep its episodes of the same code and weights")
    add("--variant", default=FULL, metavar="NAME", help=f"variant of a learned policy: {', '.join(VARIANTS)}")
    add("--no-shield", action="store_true", help="also drive a learned policy without the shield")
    compared = "paired differences between two files of episodes"
    add("--compare", nargs=2, type=cli.path, metavar="FILE.jsonl", help=compared)
    add("--video", type=cli.path, metavar="DIR", help="film the first episodes into DIR, an MP4 and a still of each")
    add(
        "--video-episodes",
        type=cli.count,
        default=3,
        metavar="N",
        help="number of episodes to film or record (default: 3)",
    )
    rerun = "record as many episodes for the Rerun viewer (needs the extra rerun)"
    add("--rerun", type=cli.path, metavar="FILE.rrd", help=rerun)
    parser.add_drives()
    return parser


def main(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    console = PlainConsole()
    if options.list:
        _list_policies()
        return 0
    with contextlib.ExitStack() as held:
        return _evaluate(options, console, held)


def _evaluate(options: argparse.Namespace, console: PlainConsole, held: contextlib.ExitStack) -> int:
    if options.json is not None:
        output_files.check_writable("--json", options.json)
    for option, file in (("--json", options.json), ("--out", options.out)):
        if file is not None:
            output_files.check_place(option, file)
            held.enter_context(locks.held(file, f"{option} {file}"))
    if options.compare:
        first, second = options.compare
        comparison = compare(first, second, options.seed)
        _write(options.json, comparison.result)
        comparison.show(console)
        return 0
    try:
        reports = _evaluate_all(options, console)
    except KeyboardInterrupt:
        if options.out is not None and options.out.exists():
            others = ("policy", "list", "compare", "resume", "debug")
            given = [name.replace("_", "-") for name in vars(options) if name not in others]
            again = commands.repeated(make_parser(), _absolute(options), given)
            streams.tell(
                f"interrupted; the episodes that have ended are in {options.out}. Resume with",
                f"  {commands.module('zsdist.evaluate', *_absolute(options).policy, '--resume', *again)}",
            )
        raise
    if len(reports) == 1:
        return 0
    result = together(reports, options.seed)
    _write(options.json, result)
    show_together(result, console)
    return 0


def find_policy(
    name: str,
    config_file: Path | str | None = None,
    variant: str = FULL,
    overrides: tuple[str, ...] = (),
    notify: config.Notify | None = None,
) -> NamedPolicy:
    """Return the policy that a POLICY argument names.

    Args:
        name: name of a baseline or a shipped policy, or path of a run directory or a checkpoint.
        config_file: configuration of a baseline's world, a preset's name as a text; a learned policy has its own.
        variant: variant of a learned policy.
        overrides: settings to change, as `KEY.PATH=VALUE`: where its weights are now, or another world.
        notify: called with lines for the user.

    Raises:
        WeightsError: it is neither a baseline nor a folder with weights, or was trained with another encoder than the
            one on this machine.
        ConfigError: the configuration file is wrong.
        RunError: an option does not fit the policy.
    """
    if variant not in VARIANTS:
        raise RunError(f"--variant is {variant!r}; allowed are {', '.join(VARIANTS)}")
    _check_overrides(overrides, name, variant)
    if notify and (line := places.find_clash("policy", name, BASELINES)):
        notify(line)
    if name in BASELINES:
        if variant != FULL:
            raise RunError(f"--variant {variant}: baseline {name!r} has no variants; allowed is a learned policy")
        return NamedPolicy(name, Contender(config.load(config_file, overrides, notify), baseline=name))
    if config_file is not None:
        raise RunError(f"--config {config_file}: a learned policy has its own configuration; remove the option")
    policy = load_by_name(name, BASELINES, overrides, notify)
    note = check_vision(policy)
    return NamedPolicy(name, Contender(policy.config, policy.parameters, variant=variant), policy.sha256, note)


def _check_overrides(overrides: tuple[str, ...], policy: str, variant: str) -> None:
    """Raise `RunError` for a setting without effect on an evaluation, or that policy or variant decide."""
    learned = policy not in BASELINES
    decided = VARIANTS[variant].agent if learned else ("high_policy", "low_policy")
    for key in (key for override in overrides for key in config.leaves_of(override)):
        section = key.partition(".")[0]
        if learned and section == "grid":
            raise RunError(f"--set {key}: the networks of a learned policy depend on it; allowed is the policy's own")
        if section == "agent" and key.rpartition(".")[2] in decided:
            owner = f"--variant {variant}" if learned else f"baseline {policy!r}"
            raise RunError(f"--set {key}: {owner} has its own; remove one of the two")
        if section not in (*SECTIONS, "scenes") and section in config.Config.model_fields:
            allowed = ", ".join((*SECTIONS, "scenes"))
            raise RunError(f"--set {key} has no effect on an evaluation; allowed are settings of {allowed}")


def _list_policies() -> None:
    for name in SHIPPED:
        say(f"{name:24} learned policy shipped with the package (observes {Observability.CAMERA})")
    for name, baseline in BASELINES.items():
        say(f"{name:24} {baseline.line} (observes {baseline.observability})")
    say("variants of a learned policy, --variant NAME:")
    for name, variant in VARIANTS.items():
        say(f"{name:24} {variant.line}")


def _evaluate_all(options: argparse.Namespace, console: PlainConsole) -> list[Report]:
    """Evaluate and show each policy, one after another."""
    if not options.policy:
        raise RunError(f"no policy was named; allowed are a run directory, a checkpoint and {', '.join(BASELINES)}")
    _check_out(options.out, options.resume)
    if options.video is not None and options.video.is_file():
        raise RunError(f"--video {options.video} is a file; allowed is a folder, which is made where it does not exist")
    if line := places.find_clash("--scenes", options.scenes, BUILT_IN):
        _note(line)
    if options.rerun is not None:
        if len(options.policy) > 1:
            raise RunError(f"--rerun {options.rerun}: {len(options.policy)} policies were named; allowed is one")
        from zsdist.reporting import rerun_log

        rerun_log.require_rerun()
        output_files.check_place("--rerun", options.rerun)
    policies = []
    for name in options.policy:
        policies.append(find_policy(name, options.config, options.variant, cli.overrides(options), _note))
        if policies[-1].note:
            _note(policies[-1].note)
    check_together(policies, options.no_shield)
    reports = []
    for policy in policies:
        reports.append(_evaluate_one(options, policy))
        if len(policies) == 1:
            _write(options.json, reports[0].result)  # before it is shown: nobody may be reading the output any longer
        reports[-1].show(console)
        if options.video is not None:
            folder = options.video if len(policies) == 1 else options.video / Path(policy.name).name
            _film(options, policy.contender, folder)
        if options.rerun is not None:
            _record(options, policy.contender)
    return reports


def _evaluate_one(options: argparse.Namespace, policy: NamedPolicy) -> Report:
    """Evaluate a policy, and with `--no-shield` the same policy without its shield."""
    contenders = [policy.contender]
    if options.no_shield:
        contenders.append(replace(policy.contender, shielded=False))
    reports = [
        evaluate(
            contender,
            policy=policy.name,
            weights_sha256=policy.weights_sha256,
            scenes=options.scenes,
            episodes=options.episodes,
            seed=options.seed,
            workers=options.workers,
            out=options.out,
        )
        for contender in contenders
    ]
    return reports[0] if len(reports) == 1 else reports[0].beside(reports[1])


def _film(options: argparse.Namespace, contender: Contender, folder: Path) -> None:
    """Drive the first episodes a second time and film them, so that filming does not slow what was measured."""
    from zsdist.reporting.film import film  # imports matplotlib, which an evaluation does not need

    scenes = select(options.scenes, contender.config, options.episodes, options.seed)[: options.video_episodes]
    with output_files.made_folder(f"--video {folder}", folder), locks.held(folder, f"--video {folder}"):
        film(contender, scenes, options.seed, folder, lambda file: say(f"film: {file}"))


def _record(options: argparse.Namespace, contender: Contender) -> None:
    """Drive the first episodes a second time, and record what the car sees, believes and does."""
    from zsdist.reporting import rerun_frames

    scenes = select(options.scenes, contender.config, options.episodes, options.seed)[: options.video_episodes]
    with output_files.written(f"--rerun {options.rerun}"), locks.held(options.rerun, f"--rerun {options.rerun}"):
        rerun_frames.record(contender, scenes, options.seed, options.rerun)
    say(f"recording: {options.rerun}; open it with: rerun --bind 127.0.0.1 {commands.quoted(options.rerun)}")


def _check_out(out: Path | None, resume: bool) -> None:
    if out is None:
        if resume:
            raise RunError("--resume needs a file of episodes to resume; add --out FILE.jsonl")
        return
    output_files.check_place("--out", out)
    if out.exists() and out.stat().st_size and not resume:
        raise RunError(f"--out {out} exists already; allowed are a new file, and --resume to resume this one")


def _absolute(options: argparse.Namespace) -> argparse.Namespace:
    """Return options whose policies, scenes and settings are absolute paths, where they are paths."""
    policies = [name if name in (*BASELINES, *SHIPPED) else places.absolute(name) for name in options.policy]
    scenes = options.scenes if options.scenes in BUILT_IN else places.absolute(options.scenes)
    settings = [cli.absolute_override(text) for text in options.set]
    return argparse.Namespace(**{**vars(options), "policy": policies, "scenes": scenes, "set": settings})


def _note(line: str) -> None:
    say(line, error=True)


def _write(file: Path | None, result: dict[str, Any]) -> None:
    if file is not None:
        output_files.write_json("--json", file, result)


if __name__ == "__main__":
    cli.execute(main, make_parser())
