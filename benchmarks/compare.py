"""Comparison of this checkout with another one: the same benchmarks alternately, and the ratio of each figure.

`python benchmarks/compare.py OTHER_CHECKOUT [--subjects sim learner] [--pairs 10]` runs each subject's `--quick` form
in the other checkout and in this one alternately. For every rate or time it takes the ratio of each pair (above 1:
this checkout is faster) and prints the median with its interval: the second lowest and the second highest of ten
pairs enclose the true median in 97.9% of cases. `all` is the geometric mean of a pair's ratios.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
from pathlib import Path

from _common import report

SUBJECTS = ("sim", "learner", "wire", "replay")
HERE = Path(__file__).resolve().parents[1]
SLOW_IS_LESS = ("_ms", "_us")  # endings of the names of figures for which less is better
RATE = "_per_s"  # part of the names of figures for which more is better, like `_per_cpu_s`


def main() -> None:
    """Run the pairs of benchmarks and print the ratio of each figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("other", type=Path, help="a checkout of an earlier commit")
    parser.add_argument("--subjects", nargs="+", choices=SUBJECTS, default=SUBJECTS)
    parser.add_argument("--pairs", type=int, default=10)
    options = parser.parse_args()
    figures, ratios = {"pairs": options.pairs}, {}
    for subject in options.subjects:
        pairs = []
        for number in range(options.pairs + 1):  # the first pair includes compilation and is left out
            before, after = measured(options.other.resolve(), subject), measured(HERE, subject)
            pairs.append({name: faster(name, before[name], after[name]) for name in before.keys() & after.keys()})
            print(f"{subject}: pair {number} of {options.pairs}", file=sys.stderr, flush=True)
        counted = [{name: ratio for name, ratio in pair.items() if ratio is not None} for pair in pairs[1:]]
        for pair in counted:
            pair["all"] = math.exp(statistics.mean(map(math.log, pair.values())))
        for name in sorted(counted[0]):
            column = sorted(pair[name] for pair in counted)
            ratios[f"{subject}_{name}_vs_other"] = statistics.median(column)
            figures[f"{subject}_{name}_low"], figures[f"{subject}_{name}_high"] = column[1], column[-2]
    report("compare", figures, ratios)


def measured(checkout: Path, subject: str) -> dict[str, float]:
    """Return the figures of a subject's quick benchmark in a checkout."""
    command = [sys.executable, str(checkout / "benchmarks" / f"{subject}.py"), "--quick"]
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{subject} in {checkout} ended with status {done.returncode}: {done.stderr[-1000:]}")
    return json.loads(done.stdout.splitlines()[-1])["figures"]


def faster(name: str, before: float, after: float) -> float | None:
    """Return the speed of `after` relative to `before`; None if the figure is neither a rate nor a time, or is 0."""
    if not before or not after:
        return None
    if RATE in name or "_per_cpu_s" in name:
        return after / before
    return before / after if name.endswith(SLOW_IS_LESS) else None


if __name__ == "__main__":
    main()
