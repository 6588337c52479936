"""Proof that a single-process run resumes to the bit: stop it at random actions, resume it, and compare the folders.

    python tests/resumption.py FOLDER [--stops 20] [--episodes 24]

One run is never stopped. Each of the others is stopped at one random action of its simulated cars, in training or in a
merge, and then resumed to its end. Odd ones are killed (SIGKILL), even ones interrupted (Ctrl-C). What must be equal:
every array and number in the kept checkpoints, the lines of `episodes.jsonl` and `metrics.jsonl`, and `summary.json`,
apart from real times and from epochs, which begin at random. A proof that was broken off goes on where it was.
"""

import argparse
import json
import random
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from zsdist.run import checkpoint_files, directory

SETTINGS = (
    "vision.network=student",
    "camera.size_px=128",
    "sim.max_steps=40",
    "merge.every_episodes=8",
    "merge.validation_scenes=3",
    "merge.drive_steps=30",
    "merge.distil_updates=20",
    "low.min_size=64",
    "run.checkpoint_every_episodes=5",
    "run.final_evaluation_episodes=0",
)
REAL_TIMES = ("wall_s", "rates", "ended_unix_s")
# The launch command, with a signal to itself at one action of its cars; without one it writes the number of actions.
LAUNCH = """
import os, runpy, sys
from zsdist.sim.env import CarNavigation

at, number, count_file, *sys.argv[1:] = sys.argv[1:]
drive, actions = CarNavigation.step, 0

def counting(env, action):
    global actions
    actions += 1
    if actions == int(at):
        os.kill(os.getpid(), int(number))
    return drive(env, action)

CarNavigation.step = counting
try:
    runpy.run_module("zsdist.launch", run_name="__main__")
finally:
    open(count_file, "w").write(str(actions))
"""


def launch(count_file: Path, *options: str, at: int = 0, number: int = 0) -> int:
    """Launch a training and return its status."""
    command = [sys.executable, "-c", LAUNCH, str(at), str(number), str(count_file), "--single-process", "--plain"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    if done.returncode not in (0, 128 + signal.SIGINT, -signal.SIGKILL):
        raise SystemExit(f"{' '.join(options)} ended with {done.returncode}\n{done.stdout}{done.stderr}")
    return done.returncode


def begin(folder: Path, count_file: Path, episodes: int, **stop: int) -> int:
    settings = [word for setting in SETTINGS for word in ("--set", setting)]
    return launch(count_file, *settings, "--run-dir", str(folder), "--episodes", str(episodes), **stop)


def content(folder: Path) -> dict:
    """Return everything in a run directory that must be equal."""
    found = {"episodes.jsonl": (folder / "episodes.jsonl").read_text()}
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    found["metrics.jsonl"] = [{key: row[key] for key in row if key != "ledger_bytes"} for row in rows]  # it has epochs
    summary = json.loads((folder / "summary.json").read_text())
    found["summary.json"] = {name: value for name, value in summary.items() if name not in REAL_TIMES}
    for checkpoint in checkpoint_files.checkpoints(folder):
        for name, state in checkpoint_files.read_checkpoint(checkpoint).items():
            meta = {key: value for key, value in state.meta.items() if key not in REAL_TIMES}
            for level in ("high", "low") if name.startswith("replay") else ():
                meta[level] = {key: value for key, value in meta[level].items() if key not in ("epochs", "closed")}
                meta[level]["learner"] = meta[level]["learner"][1:]  # without its epoch
                for stream in meta[level]["inbox"]["current"].values():
                    del stream["epoch"]
            arrays = {key: (array.dtype.str, array.shape, array.tobytes()) for key, array in state.arrays.items()}
            found[f"{checkpoint.name}/{name}"] = (meta, arrays)
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--stops", type=int, default=20)
    parser.add_argument("--episodes", type=int, default=24)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    whole, count_file = options.folder / "whole", options.folder / "actions"
    if not count_file.exists() or directory.ended(whole) != "complete":
        shutil.rmtree(whole, ignore_errors=True)
        begin(whole, count_file, options.episodes)
    expected, actions = content(whole), int(count_file.read_text())
    places = random.Random(0).sample(range(1, actions + 1), options.stops)
    failed = 0
    for index, at in enumerate(places):
        folder, verdict = options.folder / f"stop-{index:02d}", options.folder / f"stop-{index:02d}.json"
        if not verdict.exists():
            shutil.rmtree(folder, ignore_errors=True)
            number = (signal.SIGINT, signal.SIGKILL)[index % 2]
            status = begin(folder, options.folder / "stopped", options.episodes, at=at, number=number)
            assert status != 0, f"the run was not stopped at action {at}"
            kept = (
                checkpoint_files.newest_checkpoint(folder).name if checkpoint_files.has_checkpoint(folder) else "none"
            )
            if directory.ended(folder) != "complete":  # as after a Ctrl-C at the very last action
                launch(options.folder / "resumed", "--resume", str(folder))
            found = content(folder)
            different = sorted(key for key in expected.keys() | found.keys() if expected.get(key) != found.get(key))
            about = {"action": at, "of": actions, "status": status, "checkpoint": kept, "different": different}
            verdict.write_text(json.dumps(about))
            shutil.rmtree(folder)
        about = json.loads(verdict.read_text())
        failed += bool(about["different"])
        print(json.dumps(about), flush=True)
    print(json.dumps({"stops": len(places), "equal": len(places) - failed, "actions": actions}))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
