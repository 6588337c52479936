"""Success and collisions of the shipped policy, baselines, ablations and oracles on the test scenes.

`python benchmarks/driving.py [--quick] [--episodes N] [--seed S] [--runs RUN...] [--out DIR]` evaluates each
contender of `CONTENDERS`, and the policies of the given runs, on each family of `SPLITS` with `zsdist.evaluate`, one
after the other, and prints a table and one JSON line. `--splits` chooses other test families. Runs of one name are
training seeds of one contender. After an interruption the same command resumes: episodes are kept in DIR with the
hashes of the code and the weights that drove them. `python -m zsdist.report DIR` writes a page of them with paired
differences and figures.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from _common import report

from zsdist import config
from zsdist.errors import ConfigError
from zsdist.sim.scenes.manifest import MANIFEST

SPLITS = ("iid", "ood-start-goal", "ood-layout", "ood-clusters", "ood-dynamic")
FAMILIES = MANIFEST["test"].families
# Arguments of `zsdist.evaluate` by the name in the table: first the claimed policies, then upper bounds, baselines
# without a map, and the policy with a part removed or replaced.
CONTENDERS = {
    "full": ("pretrained",),
    "hybrid": ("pretrained", "--variant", "hybrid"),
    "astar-frontier": ("astar-frontier",),
    "astar-vision": ("astar-vision",),
    "astar": ("astar",),
    "potential-field": ("potential-field",),
    "potential-field-no-trail": ("potential-field-no-trail",),
    "goal-greedy": ("goal-greedy",),
    "random": ("random",),
} | {
    name: ("pretrained", "--variant", name)
    for name in (
        "untrained-high",
        "untrained-low",
        "untrained",
        "shuffled-advice",
        "shuffled-vision",
        "oracle-depth",
        "oracle-high",
        "oracle-levels",
        "oracle-motion",
    )
}
NO_SHIELD = "no-shield"
CONTENDERS[NO_SHIELD] = ("pretrained", "--no-shield")


def main() -> None:
    """Evaluate all contenders and print their figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add(
        "--quick",
        action="store_true",
        help="2 episodes of the first three contenders; ends within 3 minutes on two cores",
    )
    add("--episodes", type=int, default=150, metavar="N", help="episodes per contender and split (default: 150)")
    add("--seed", type=int, default=1, metavar="S", help="seed that selects the test scenes (default: 1)")
    names = ", ".join(CONTENDERS)
    add("--entrants", nargs="+", choices=CONTENDERS, default=list(CONTENDERS), metavar="NAME", help=names)
    families = ", ".join(FAMILIES)
    add("--splits", nargs="+", choices=FAMILIES, default=list(SPLITS), metavar="SPLIT", help=families)
    add("--runs", nargs="+", type=Path, default=[], metavar="RUN", help="run directories that zsdist.launch made")
    add("--out", type=Path, metavar="DIR", help="folder of the episodes (default: a temporary folder)")
    options = parser.parse_args()
    if options.quick:
        options.entrants, options.episodes = options.entrants[:3], 2
    try:
        contenders = {name: CONTENDERS[name] for name in options.entrants} | _trained(options.runs)
    except ConfigError as error:
        parser.error(str(error))
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        figures = {}
        for contender, arguments in contenders.items():
            for split in options.splits:
                result = _evaluated(contender, arguments, split, options.episodes, options.seed, folder)
                figures |= {f"{contender}, {split}: {key}": result.get(key) for key in ("success", "collision", "spl")}
    report("driving", {name: value for name, value in figures.items() if value is not None}, {})


def _trained(runs: list[Path]) -> dict[str, tuple[str, ...]]:
    """Return arguments of `zsdist.evaluate` by name of the run; raise `ConfigError` if a folder holds no run."""
    contenders: dict[str, tuple[str, ...]] = {}
    for run in runs:
        name = config.load(run / "config.yaml").run.name
        contenders[name] = (*contenders.get(name, ()), str(run))
    return contenders


def _evaluated(
    contender: str, arguments: tuple[str, ...], split: str, episodes: int, seed: int, folder: Path
) -> dict[str, float | None]:
    """Return the result of one contender on one split; with several training seeds, the interquartile mean.

    Episodes that are already in the contender's file are not driven again.
    """
    command = [sys.executable, "-m", "zsdist.evaluate", *arguments, "--scenes", split, "--seed", str(seed)]
    file = "full" if contender == NO_SHIELD else contender  # `--no-shield` drives with the shield as well
    command += ["--episodes", str(episodes), "--out", str(folder / f"{file}.jsonl"), "--resume"]
    with tempfile.NamedTemporaryFile(suffix=".json") as output:
        subprocess.run([*command, "--json", output.name], check=True)
        result = json.loads(Path(output.name).read_text())
    if contender == NO_SHIELD:
        return result["without_shield"]
    return result.get("interquartile_mean", result)


if __name__ == "__main__":
    main()
