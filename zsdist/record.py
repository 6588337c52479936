"""`python -m zsdist.record POLICY --out DIR`: drive a policy and record a data set, whole after each episode.

The policy drives as in an evaluation. Each episode becomes an MCAP file with ROS 2 messages, which is there once it is
complete. With `--format minari` a Minari data set grows beside them. `zsdist.launch --set replay.start_from=[DIR]`
trains from the set.
"""

import argparse
import contextlib
from collections import Counter
from pathlib import Path

import zsdist
from zsdist.common import cli, commands, locks, output_files, places, streams
from zsdist.common.console import say
from zsdist.errors import RunError
from zsdist.evaluate import find_policy
from zsdist.evaluation import recorded_drives
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.contenders import FULL, VARIANTS
from zsdist.evaluation.policies import NamedPolicy
from zsdist.evaluation.recorded_drives import RecordedDrive, RecordingJob
from zsdist.evaluation.selection import BUILT_IN, select
from zsdist.planning.grid import Grid
from zsdist.recording import log
from zsdist.recording.contract import TransitionContract, flat
from zsdist.recording.episode import read_episode
from zsdist.recording.minari_export import MinariSet, require_minari, set_name
from zsdist.recording.recorded_set import MANIFEST, RecordedSet, SetManifest, write_manifest
from zsdist.run.policies import SHIPPED
from zsdist.types import Outcome

FORMATS = ("mcap", "minari")
MINARI = "minari"  # folder in DIR that Minari takes as MINARI_DATASETS_PATH
MANY = 10  # episodes between two lines of progress


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.record", description=__doc__)
    add = parser.add_argument
    add("policy", nargs="?", help="run directory, checkpoint, pretrained, or a baseline (zsdist evaluate --list)")
    scenes = "a folder of scene files, a family, or train, validation, test (default: test)"
    add("--scenes", default="test", help=scenes)
    add("--episodes", type=cli.count, help="number of episodes (default: every file of a folder, else 50)")
    add("--seed", type=cli.natural, default=0, help="seed that selects the scenes of a family (default: 0)")
    add("--format", choices=FORMATS, default=FORMATS[0], help="mcap, or minari beside it, then without loss")
    add("--out", type=cli.path, metavar="DIR", help="folder of the set")
    add("--resume", action="store_true", help="resume the set in --out DIR: keep its episodes, drive the others")
    add("--variant", default=FULL, metavar="NAME", help=f"variant of a learned policy: {', '.join(VARIANTS)}")
    parser.add_drives()
    repair = "make FILE whole again, the MCAP file of a recording that was killed"
    add("--repair", type=cli.path, metavar="FILE.mcap", help=repair)
    return parser


def main(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    if options.repair is not None:
        if options.policy is not None:
            raise RunError("--repair takes no POLICY: it drives nothing; give one of the two")
        if not options.repair.is_file():
            raise RunError(f"--repair is {str(options.repair)!r}, which is not a file; allowed is an MCAP file")
        count = log.salvage(options.repair, options.repair)
        say(f"{options.repair} is whole: {count} messages")
        return 0
    if options.policy is None:
        raise RunError("no policy was named; allowed are a run directory, a checkpoint, pretrained and the baselines")
    if options.out is None:
        raise RunError("--out is missing; it is the folder of the set, which is made where it does not exist")
    if options.format == "minari":
        require_minari()
    if line := places.find_clash("--scenes", options.scenes, BUILT_IN):
        say(line, error=True)
    policy = find_policy(options.policy, options.config, options.variant, cli.overrides(options), _note)
    if policy.note:
        _note(policy.note)
    if options.out.is_file():
        raise RunError(f"--out {options.out} is a file; allowed is a folder")
    with output_files.written(f"--out {options.out}"):
        _check_resumable(options)
    what = f"--out {options.out}"
    with output_files.made_folder(what, options.out), locks.held(options.out, what):
        try:
            _record(options, policy)
        except KeyboardInterrupt:
            _tell_how_to_resume(options)
            raise
    return 0


def _record(options: argparse.Namespace, policy: NamedPolicy) -> None:
    manifest = _manifest(options, policy)
    contender = policy.contender
    scenes = select(options.scenes, contender.config, options.episodes, options.seed)
    folder = options.out
    if (folder / MANIFEST).exists():
        manifest = _common(RecordedSet(folder).manifest, manifest, folder)
    else:
        write_manifest(folder, manifest)
    recorded = RecordedSet(folder)
    known = recorded.episodes()
    drives = [RecordedDrive(number, scene) for number, scene in enumerate(scenes) if number not in known]
    exported = _minari_set(options, policy, manifest) if options.format == "minari" else None
    if known:
        say(f"{len(known)} episodes are in {folder}; {len(drives)} are left to drive")
    _export(exported, recorded)
    outcomes: Counter[Outcome] = Counter()
    job = RecordingJob(contender, manifest, folder, options.seed)
    with contextlib.closing(recorded_drives.record_each(job, drives, options.workers)) as driven:
        for done, (_, record) in enumerate(driven, 1):
            outcomes[record.outcome] += 1
            _export(exported, recorded)
            if done % MANY == 0 or done == len(drives):
                said = ", ".join(f"{outcomes[outcome]} {outcome}" for outcome in Outcome)
                say(f"{policy.name}: {done} of {len(drives)} episodes recorded ({said})")
    say(f"set: {folder} ({len(recorded.episodes())} episodes)")
    if exported is not None:
        say(f"Minari: {exported.path} ({exported.episodes} episodes)")


def _manifest(options: argparse.Namespace, policy: NamedPolicy) -> SetManifest:
    contender = policy.contender
    has_levels = recorded_drives.makes_transitions(contender)
    return SetManifest(
        zsdist=zsdist.__version__,
        policy=policy.name,
        variant="" if contender.baseline else contender.variant,
        weights_sha256=policy.weights_sha256,
        scenes=options.scenes if options.scenes in BUILT_IN else places.absolute(options.scenes),
        seed=options.seed,
        pictures="png" if options.format == "minari" else "jpeg",
        camera=contender.config.camera,
        transitions=TransitionContract.of(contender.config) if has_levels else None,
    )


def _common(before: SetManifest, now: SetManifest, folder: Path) -> SetManifest:
    """Return the manifest of a set that is resumed, in its own form of pictures; what else differs is refused."""
    free = {"pictures", "zsdist"} | ({"policy"} if before.weights_sha256 else set())  # their hash names the networks
    ours, others = (flat(manifest.model_dump(mode="json", exclude=free)) for manifest in (before, now))
    for name in [*ours, *others]:
        if ours.get(name) != others.get(name):
            raise RunError(
                f"--resume: the set in {folder} was recorded with {name} {ours.get(name)} and this is "
                f"{others.get(name)}; allowed is the same policy, scenes and seed, or another folder"
            )
    return before


def _minari_set(options: argparse.Namespace, policy: NamedPolicy, manifest: SetManifest) -> MinariSet:
    contender = policy.contender
    name = set_name([Path(manifest.policy).name, manifest.variant.removeprefix(FULL), Path(manifest.scenes).name])
    about = {
        "algorithm_name": policy.name,
        "description": f"{manifest.policy} drives {manifest.scenes} scenes; pictures recorded as {manifest.pictures}",
        "requirements": [f"zsdist=={manifest.zsdist}"],
    }
    grid, settings = Grid.from_config(contender.config.grid), contender.config.model_dump(mode="json")
    return MinariSet(options.out / MINARI, name, grid, settings, about)


def _export(exported: MinariSet | None, recorded: RecordedSet) -> None:
    """Add to a Minari set the episodes that it lacks, in order, up to the first that is not recorded yet."""
    if exported is None:
        return
    files = recorded.episodes()
    while (path := files.get(exported.episodes)) is not None:
        exported.append(read_episode(path))


def _check_resumable(options: argparse.Namespace) -> None:
    has_set = (options.out / MANIFEST).exists()
    if has_set and not options.resume:
        raise RunError(f"--out {options.out} holds a set already; allowed are a new folder, and --resume to resume it")
    if options.resume and not has_set:
        raise RunError(f"--resume: {options.out} holds no set; allowed is a folder made by zsdist record")


def _tell_how_to_resume(options: argparse.Namespace) -> None:
    names = ("scenes", "episodes", "seed", "format", "variant", "config", "set", "workers")
    absolute = argparse.Namespace(
        **vars(options)
        | {
            "out": places.absolute(str(options.out)),
            "scenes": options.scenes if options.scenes in BUILT_IN else places.absolute(options.scenes),
            "set": [cli.absolute_override(text) for text in options.set],
        }
    )
    again = commands.repeated(make_parser(), absolute, ("out", *names))
    policy = options.policy if options.policy in (*BASELINES, *SHIPPED) else places.absolute(options.policy)
    streams.tell(
        f"interrupted; the finished episodes are in {options.out}. Resume with",
        f"  {commands.module('zsdist.record', policy, '--resume', *again)}",
    )


def _note(line: str) -> None:
    say(line, error=True)


if __name__ == "__main__":
    cli.execute(main, make_parser())
