"""How well the shipped policy drives beside everything that it is held against, on the test scenes.

`python benchmarks/driving.py [--quick] [--episodes N] [--seed S] [--runs RUN...] [--out DIR]` evaluates each entrant of
`ENTRANTS`, and what the runs have trained, on each split of `SPLITS` by `zsdist.evaluate`, one after the other, and
prints a table and one JSON line. Runs of one name are training seeds of one entrant. It goes on where it was broken
off: episodes stay in DIR with the hashes of the code and the weights that they were driven with.
`python -m zsdist.report DIR` makes the page with paired differences and figures of them.
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

SPLITS = ("iid", "ood-start-goal", "ood-layout", "ood-clusters", "ood-dynamic")
# By the name in the table: what `zsdist.evaluate` is called with. The first are what is claimed, then the ceilings, the
# baselines without a map, and the policy with something taken away or put in its place.
ENTRANTS = {
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
ENTRANTS[NO_SHIELD] = ("pretrained", "--no-shield")


def main() -> None:
    """Drive, print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add(
        "--quick",
        action="store_true",
        help="2 episodes of the first three entrants; ends within 3 minutes on two cores",
    )
    add("--episodes", type=int, default=150, metavar="N", help="of each entrant on each split (default: 150)")
    add("--seed", type=int, default=1, metavar="S", help="which test scenes (default: 1)")
    add("--entrants", nargs="+", choices=ENTRANTS, default=list(ENTRANTS), metavar="NAME", help=", ".join(ENTRANTS))
    add("--splits", nargs="+", choices=SPLITS, default=list(SPLITS), metavar="SPLIT", help=", ".join(SPLITS))
    add("--runs", nargs="+", type=Path, default=[], metavar="RUN", help="run directories, trained by zsdist.launch")
    add("--out", type=Path, metavar="DIR", help="of the episodes (default: a temporary folder)")
    options = parser.parse_args()
    if options.quick:
        options.contenders, options.episodes = options.contenders[:3], 2
    try:
        called = {name: ENTRANTS[name] for name in options.contenders} | _trained(options.runs)
    except ConfigError as error:
        parser.error(str(error))
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        figures = {}
        for contender, arguments in called.items():
            for split in options.splits:
                result = _evaluated(contender, arguments, split, options.episodes, options.seed, folder)
                figures |= {f"{contender}, {split}: {key}": result.get(key) for key in ("success", "collision", "spl")}
    report("driving", {name: value for name, value in figures.items() if value is not None}, {})


def _trained(runs: list[Path]) -> dict[str, tuple[str, ...]]:
    """Entrants by the names of their runs; raises `ConfigError` where a folder holds no run."""
    contenders: dict[str, tuple[str, ...]] = {}
    for run in runs:
        name = config.load(run / "config.yaml").run.name
        contenders[name] = (*contenders.get(name, ()), str(run))
    return contenders


def _evaluated(
    contender: str, arguments: tuple[str, ...], split: str, episodes: int, seed: int, folder: Path
) -> dict[str, float | None]:
    """The result of one entrant on one split (over training seeds the interquartile mean); what is on file stays."""
    command = [sys.executable, "-m", "zsdist.evaluate", *arguments, "--scenes", split, "--seed", str(seed)]
    file = "full" if contender == NO_SHIELD else contender  # which is driven with the shield as well
    command += ["--episodes", str(episodes), "--out", str(folder / f"{file}.jsonl"), "--resume"]
    with tempfile.NamedTemporaryFile(suffix=".json") as told:
        subprocess.run([*command, "--json", told.name], check=True)
        result = json.loads(Path(told.name).read_text())
    if contender == NO_SHIELD:
        return result["without_shield"]
    return result.get("interquartile_mean", result)


if __name__ == "__main__":
    main()
