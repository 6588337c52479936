"""Proof that two checkouts behave the same to the bit: record hashes of what each does, then compare the records.

    python tests/proof.py record OLD_CHECKOUT old.json
    python tests/proof.py record . new.json
    python tests/proof.py compare old.json new.json

A record holds, for single-process runs (default and scattered, two seeds), the hashes of the final weights, of every
trajectory that the replay decoded and of every finished episode; and for greedy evaluations of `pretrained` in four
families, the hash of every episode. Only command lines and the codec are used, which stay as they are. A record that
was broken off is resumed. `--quick` records two shorter runs and ten episodes a family.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

EVALUATED = ("iid", "ood-layout", "ood-clusters", "ood-dynamic")
TIMES = ("decision_ms",)  # fields of an episode that differ from drive to drive
RUNS = {  # name: configuration, seed, episodes; 100 of them and more see a merge
    "default-0": ("default", 0, 150),
    "default-1": ("default", 1, 150),
    "scattered-0": ("scattered", 0, 110),
    "scattered-1": ("scattered", 1, 110),
}
QUICK_RUNS = {"default-0": ("default", 0, 12), "scattered-0": ("scattered", 0, 12)}

# Runs in the checkout under proof: the launch command, with a hash over all trajectories that the replay decodes. The
# frames around them are left out, since they carry epochs, which begin with the time.
LAUNCH = """
import hashlib, runpy, sys
from zsdist.wire import codec

COLUMNS = "states", "actions", "rewards", "discounts", "successors", "masks", "guides", "behaviours"

trajectories, decode = hashlib.sha256(), codec.decode

def recording(payload, **options):
    message = decode(payload, **options)
    for trajectory in getattr(message, "trajectories", ()):
        trajectories.update(f"{message.actor} {message.sequence} {trajectory.level}".encode())
        trajectories.update(str(trajectory.weight_version).encode())
        for name in COLUMNS:
            trajectories.update(getattr(trajectory, name).tobytes())
    return message

codec.decode = recording
hash_file, *sys.argv[1:] = sys.argv[1:]
try:
    runpy.run_module("zsdist.launch", run_name="__main__")
finally:
    open(hash_file, "w").write(trajectories.hexdigest())
"""


def record_run(tree: Path, configuration: str, seed: int, episodes: int, quick: bool) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        run, hash_file = Path(folder, "run"), Path(folder, "trajectories")
        command = [sys.executable, "-c", LAUNCH, str(hash_file), "--single-process", "--plain"]
        command += ["--config", str(tree / "configs" / f"{configuration}.yaml"), "--run-dir", str(run)]
        command += ["--seed", str(seed), "--episodes", str(episodes), "--set", "run.final_evaluation_episodes=0"]
        if quick:
            command += ["--set", "merge.every_episodes=8", "--set", "merge.validation_scenes=4"]
        finish(tree, command, folder)
        summary = json.loads((run / "summary.json").read_text())
        return {
            "weights": summary["weights"]["sha256"],
            "transitions": summary["transitions"],
            "merges": summary["merges"],
            "trajectories": hash_file.read_text(),
            "episodes": hashed(json.loads(line) for line in (run / "episodes.jsonl").read_text().splitlines()),
        }


def record_evaluation(tree: Path, family: str, episodes: int) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out.jsonl")
        command = [sys.executable, "-m", "zsdist.evaluate", "pretrained", "--scenes", family]
        command += ["--episodes", str(episodes), "--workers", "1", "--out", str(out)]
        finish(tree, command, folder)
        lines = [json.loads(line) for line in out.read_text().splitlines()]
    # The hashes of code and contender change with the code; the episode may not.
    kept = [{key: value for key, value in line.items() if key not in (*TIMES, "code", "entrant")} for line in lines]
    return {"episodes": hashed(sorted(kept, key=lambda line: line["index"])), "count": len(kept)}


def finish(tree: Path, command: list[str], folder: str) -> None:
    environment = os.environ | {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command[:6])} ... ended with {done.returncode}:\n{done.stdout}{done.stderr}")


def hashed(objects) -> str:
    digest = hashlib.sha256()
    for one in objects:
        digest.update(json.dumps(one, sort_keys=True).encode() + b"\n")
    return digest.hexdigest()


def record(tree: Path, file: Path, quick: bool, workers: int) -> None:
    parts = json.loads(file.read_text()) if file.exists() else {}
    jobs = {f"evaluate {family}": (record_evaluation, family, 10 if quick else 40) for family in EVALUATED}
    jobs |= {f"run {name}": (record_run, *run, quick) for name, run in (QUICK_RUNS if quick else RUNS).items()}
    with ThreadPoolExecutor(workers) as pool:
        waiting = {
            pool.submit(job, tree, *arguments): name
            for name, (job, *arguments) in reversed(jobs.items())
            if name not in parts
        }
        for future in as_completed(waiting):
            parts[waiting[future]] = future.result()
            file.write_text(json.dumps(parts, indent=1, sort_keys=True) + "\n")
            print(f"recorded: {waiting[future]}", flush=True)


def compare(old: Path, new: Path) -> int:
    before, after = json.loads(old.read_text()), json.loads(new.read_text())
    different = [name for name in sorted({*before, *after}) if before.get(name) != after.get(name)]
    for name in sorted({*before, *after}):
        print(f"{'DIFFERENT' if name in different else 'equal':10s} {name}")
    return 1 if different or not before else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record")
    recording.add_argument("tree", type=Path)
    recording.add_argument("file", type=Path)
    recording.add_argument("--quick", action="store_true")
    recording.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    comparing = commands.add_parser("compare")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    options = parser.parse_args()
    if options.command == "compare":
        return compare(options.old, options.new)
    record(options.tree.resolve(), options.file, options.quick, options.workers)
    return 0


if __name__ == "__main__":
    sys.exit(main())
