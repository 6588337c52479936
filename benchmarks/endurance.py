"""CPU time per step and resident memory over thousands of episodes: neither should grow.

`python benchmarks/endurance.py [--quick] [--episodes N]` prints a table, then one JSON line. Episodes are short: a
reset, some random actions, a picture after each. Scenes come from several families and do not repeat, so that caches of
scenes are replaced all the time. The first tenth fills the caches and is not counted. The rest is reported in tenths;
ratios compare its last tenth with its first: CPU time of a step, CPU time of a reset, resident memory.
"""

import argparse
import os
import statistics
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from _common import report
from rich.progress import track

from zsdist.config import Config
from zsdist.sim.env import CarNavigation
from zsdist.sim.scenes.families import draw

FAMILIES = ("singleton", "iid", "street")
ACTIONS = 5
PARTS = 10
DISTINCT = 900  # number of scenes of each family before they repeat: many more than any cache holds


def main() -> None:
    """Drive the episodes and print their figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="500 episodes; ends within 50 s on two cores")
    parser.add_argument("--episodes", type=int, default=10_000, metavar="N", help="(default: 10000)")
    options = parser.parse_args()
    episodes = 500 if options.quick else options.episodes
    env = CarNavigation(config=Config(), images=False)
    rng = np.random.default_rng(0)
    steps_ms, resets_ms, resident = [], [], []
    for episode in track(range(episodes), description="episodes"):
        family = FAMILIES[episode % len(FAMILIES)]
        scene = draw(family, "train", episode // len(FAMILIES) % DISTINCT)
        began = time.process_time()
        env.reset(options={"scene": scene})
        env.picture()
        resets_ms.append(1e3 * (time.process_time() - began))
        began, steps = time.process_time(), 0
        for _ in range(ACTIONS):
            *_, terminated, truncated, _ = env.step(int(rng.integers(5)))
            env.picture()
            steps += 1
            if terminated or truncated:
                break
        steps_ms.append(1e3 * (time.process_time() - began) / steps)
        resident.append(_resident_mib())
    counted = np.array_split(np.arange(episodes // PARTS, episodes), PARTS)
    print(f"{'episodes':>16}{'ms per step':>12}{'ms per reset':>13}{'MiB resident':>14}")
    rows = []
    for part in counted:
        row = [statistics.median(values[part[0] : part[-1] + 1]) for values in (steps_ms, resets_ms, resident)]
        print(f"{part[0]:7d} to {part[-1]:5d}{row[0]:12.3f}{row[1]:13.3f}{row[2]:14.1f}")
        rows.append(row)
    figures = {
        "episodes": float(episodes),
        "step_first_ms": rows[0][0],
        "step_last_ms": rows[-1][0],
        "reset_ms": statistics.median(resets_ms),
        "resident_first_mib": rows[0][2],
        "resident_last_mib": rows[-1][2],
    }
    ratios = {f"{name}_last_vs_first": rows[-1][k] / rows[0][k] for k, name in enumerate(("step", "reset", "resident"))}
    report("endurance", figures, ratios)


def _resident_mib() -> float:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    main()
