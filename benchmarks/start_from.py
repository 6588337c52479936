"""Episodes until a policy drives `singleton` well: a run that starts from a recorded set, and one that starts empty.

`python benchmarks/start_from.py [--seeds 3] [--set DIR] [--results FILE]`

The set has 200 episodes of the shipped policy in as many scenes of `iid` (`zsdist record pretrained --scenes iid
--episodes 200`; in the ten scenes of `singleton` a greedy policy drives the same ten episodes again and again). It is
recorded where it is missing or unfinished. Each run makes a checkpoint every two episodes, and
the checkpoints drive greedily through the ten scenes, in order, until nine or ten of them arrive. Both kinds of runs
have one configuration and one process, so that a seed repeats bit for bit. A finished run adds a line of JSON to FILE,
and a second call goes on behind the last line.
"""

import argparse
import json
import statistics
import subprocess
import sys
from pathlib import Path

from _common import report

GOAL = 0.9
EPISODES, EVERY = 20, 2
SCENES = 10  # the family has ten
SETTINGS = (
    "vision.network=student",
    "camera.size_px=128",
    "merge.every_episodes=0",
    "run.final_evaluation_episodes=0",
    "run.checkpoints_kept=100",
    f"run.checkpoint_every_episodes={EVERY}",
)
KINDS = ("empty", "recorded")


def record(folder: Path, episodes: int) -> None:
    """Record the set, or what is missing of it."""
    words = ["record", "pretrained", "--scenes", "iid", "--episodes", str(episodes), "--out", str(folder)]
    _call(*words, *(["--resume"] if (folder / "set.json").exists() else []))


def train(folder: Path, seed: int, kind: str, recorded: Path) -> None:
    """Train a run in a folder, or resume it."""
    if (folder / "summary.json").exists():
        return
    given = [f"--set={setting}" for setting in SETTINGS]
    if kind == "recorded":
        given.append(f"--set=replay.start_from=[{recorded}]")
    words = ["launch", "--single-process", "--plain", "--episodes", str(EPISODES), "--seed", str(seed), *given]
    _call(*words, "--run-dir", str(folder), "--auto-resume")


def evaluate(folder: Path) -> list[dict]:
    """Drive the checkpoints of a run in order until the goal is reached; return one row for each."""
    rows = []
    for checkpoint in sorted(folder.glob("checkpoints/[0-9]*")):
        result = folder / f"evaluation-{checkpoint.name}.json"
        if not result.exists():
            words = ["evaluate", str(checkpoint), "--scenes", "singleton", "--episodes", str(SCENES), "--seed", "1"]
            _call(*words, "--json", str(result), "--workers", "1")
        found = json.loads(result.read_text(encoding="utf-8"))
        rows.append({"episodes": int(checkpoint.name), "success": found["success"], "spl": found["spl"]})
        if found["success"] >= GOAL:
            break
    return rows


def main() -> None:
    """Add rows until there is one for each seed and kind, and print both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--recorded-episodes", type=int, default=200)
    parser.add_argument("--set", type=Path, default=Path("runs/start-from/set"), help="folder of the recorded set")
    parser.add_argument("--results", type=Path, default=Path("runs/start-from/results.jsonl"), help="appended to")
    options = parser.parse_args()
    options.results.parent.mkdir(parents=True, exist_ok=True)
    record(options.set, options.recorded_episodes)
    for seed in range(1, options.seeds + 1):
        for kind in KINDS:
            about = {"seed": seed, "kind": kind, "recorded": options.recorded_episodes, "every": EVERY}
            if any(about.items() <= row.items() for row in _rows(options.results)):
                continue
            folder = options.results.parent / f"{kind}-{seed}"
            train(folder, seed, kind, options.set.absolute())
            rows = evaluate(folder)
            summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
            row = about | {
                "episodes_to_goal": rows[-1]["episodes"] if rows[-1]["success"] >= GOAL else None,
                "checkpoints": rows,
                "stored": summary["transitions"]["low"]["stored"],
                "outcomes": summary["outcomes"],
            }
            with options.results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            print(json.dumps(row), flush=True)
    rows = _rows(options.results)
    figures = {}
    for kind in KINDS:
        found = [row["episodes_to_goal"] for row in rows if row["kind"] == kind]
        print(f"{kind}: episodes to {GOAL:g} success in singleton, by seed: {found} (None: more than {EPISODES})")
        figures[f"episodes_to_{GOAL:g}_{kind}_median"] = float(
            statistics.median(EPISODES + EVERY if one is None else one for one in found)
        )
    report("start_from", figures, {})


def _call(*words: str) -> None:
    subprocess.run([sys.executable, "-m", f"zsdist.{words[0]}", *words[1:]], check=True, stdout=subprocess.DEVNULL)


def _rows(results: Path) -> list[dict]:
    return [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()] if results.exists() else []


if __name__ == "__main__":
    main()
