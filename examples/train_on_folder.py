"""Train in the scenes of a folder, in this process, and print how the episodes end.

Usage: `python examples/train_on_folder.py [SCENES] [RUN] [EPISODES]`, by default `configs/scenes runs/example 4`.
RUN is a new folder. The same from a shell:
`python -m zsdist.launch --single-process --episodes 4 --set 'scenes.train=["configs/scenes"]' --run-dir runs/example`
"""

import json
import sys
from pathlib import Path

from zsdist import launch
from zsdist.evaluate import find_policy


def main(scenes: str = "configs/scenes", run: str = "runs/example", episodes: str = "4") -> list[str]:
    """Train for some episodes and return their outcomes."""
    options = ["--single-process", "--plain", "--episodes", episodes, "--run-dir", run]
    options += ["--set", f"scenes.train={json.dumps([scenes])}", "--set", "run.final_evaluation_episodes=0"]
    launch.main(launch.make_parser().parse_args(options))
    outcomes = []
    for line in (Path(run) / "episodes.jsonl").read_text().splitlines():
        episode = json.loads(line)
        outcomes.append(episode["outcome"])
        print(f"episode {episode['episode']} in {episode['scene']}: {episode['outcome']}, return {episode['return']}")
    policy = find_policy(run)
    print(f"policy {policy.weights_sha256} of run {policy.contender.config.run.name!r} is in {run}/checkpoints")
    return outcomes


if __name__ == "__main__":
    main(*sys.argv[1:])
