"""Learning under kills: runs of `scattered` in which something is killed every 20 seconds, and the same without.

`python tests/chaos/learning.py [--seeds 5] [--results FILE]`, or `make chaos-learning SEEDS=5`

Everything is real: cars, camera, network, evaluation. Each policy drives through the same scenes, greedily. A finished
run or evaluation adds a line of JSON to FILE, and a second call goes on behind the last line. The goal is that the
success of the two kinds of runs differs by at most 3 points.
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path

from kills import ROLES
from small_run import Launcher, Witness, end_cleanly, moments, wait_for

CONFIG = Path(__file__).parents[2] / "configs" / "scattered.yaml"
EVERY_S = 20.0
RUN_WITHIN_S = 4 * 3600.0
LEAST_FREE_S = 3.0  # from the first statistics of a role to the first kill


def train(root: Path, seed: int, episodes: int, *, killed: bool) -> dict:
    """Train a policy in `root/run`, with kills or without, and return what was killed and how long it took."""
    command = [sys.executable, "-m", "zsdist.launch", "--config", str(CONFIG), "--actors", "2", "--seed", str(seed)]
    command += ["--run-dir", str(root / "run"), "--plain", "--set", "run.final_evaluation_episodes=0"]
    launcher = Launcher(root, command=[*command, "--episodes", str(episodes)])
    witness, random = Witness(launcher), moments(seed)
    kills: dict[str, int] = {}
    began_s = time.time()
    next_s = began_s + LEAST_FREE_S

    def ended() -> bool:
        nonlocal next_s
        now = time.time()
        if not any(witness.name_of(role) for role in ROLES):
            next_s = now + LEAST_FREE_S  # it still starts
        elif killed and now > next_s:
            next_s = now + random.uniform(0.5, 1.5) * EVERY_S
            name = random.choice([name for role in ROLES for name in witness.name_of(role)])
            os.kill(witness.statistics[name]["pid"], signal.SIGKILL)
            kills[name] = kills.get(name, 0) + 1
            print(f"{time.strftime('%H:%M:%S')} killed {name}", file=sys.stderr, flush=True)
        return launcher.process.poll() is not None

    try:
        wait_for(ended, RUN_WITHIN_S, "the end of the run", witness.poll)
        if launcher.process.returncode:
            raise AssertionError(f"the run has ended with {launcher.process.returncode}: {launcher.last_words()}")
    finally:
        witness.close()
        launcher.kill(alone=False)
    summary = json.loads((launcher.folder / "summary.json").read_text())
    return {"kills": kills, "train_s": round(time.time() - began_s, 1), "restarts": summary["restarts"]}


def evaluate(folder: Path, scenes: int) -> dict:
    """Drive the policy of a run through unseen scenes, and return its success and collisions."""
    result = folder.parent / "evaluation.json"
    command = [sys.executable, "-m", "zsdist.evaluate", str(folder), "--scenes", "iid", "--episodes", str(scenes)]
    subprocess.run([*command, "--json", str(result)], check=True, stdout=subprocess.DEVNULL)
    return json.loads(result.read_text())


def main() -> None:
    """Add rows until there is one for each seed with and without kills, and print the difference."""
    end_cleanly()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=800, help="of a training")
    parser.add_argument("--scenes", type=int, default=150, help="of an evaluation")
    parser.add_argument("--results", type=Path, default=Path("runs/learning.jsonl"), help="appended to")
    options = parser.parse_args()
    options.results.parent.mkdir(parents=True, exist_ok=True)
    for seed in range(1, options.seeds + 1):
        for killed in (False, True):
            about = {"seed": seed, "killed": killed, "episodes": options.episodes, "scenes": options.scenes}
            if any(about.items() <= row.items() for row in _rows(options.results)):
                continue
            root = options.results.parent / f"learning-{seed}-{'killed' if killed else 'whole'}-{time.time():.0f}"
            row = about | train(root, seed, options.episodes, killed=killed)
            row |= {"result": evaluate(root / "run", options.scenes)}
            with options.results.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(json.dumps({name: value for name, value in row.items() if name != "result"}), flush=True)
    rows = _rows(options.results)
    success = {killed: [_success(row) for row in rows if row["killed"] is killed] for killed in (False, True)}
    print(json.dumps({"whole": success[False], "killed": success[True]} | _difference(success)))


def _success(row: dict) -> float:
    return round(100 * row["result"]["success"], 2)


def _difference(success: dict[bool, list[float]]) -> dict:
    if not all(success.values()):
        return {}
    return {"killed_minus_whole_points": round(statistics.mean(success[True]) - statistics.mean(success[False]), 2)}


def _rows(results: Path) -> list[dict]:
    return [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []


if __name__ == "__main__":
    main()
