"""Run directories and evaluations written by hand, for tests of their readers."""

import hashlib
import json

from zsdist import config

RESULT = {
    "policy": "trained",
    "weights_sha256": "ab" * 32,
    "scenes": "iid",
    "episodes": 10,
    "seed": 0,
    "success": 0.9,
    "collision": 0.1,
    "timeout": 0.0,
    "spl": 0.6,
    "path_efficiency": 0.8,
    "step_efficiency": 0.7,
    "per_scene": [{"scene": f"iid-{index}", "outcome": "success" if index else "collision"} for index in range(10)],
    "confidence_95": {"success": [0.6, 0.98], "collision": [0.02, 0.4], "timeout": [0.0, 0.28], "spl": [0.5, 0.7]},
}


FINISHED = {"merges": [], "env_steps": 10, "wall_s": 60.0, "ended": "complete"}
WEIGHTS = {"sha256": {"high": "1" * 64, "low": "2" * 64}}  # of `make_run`'s summaries
WEIGHTS_SHA256 = hashlib.sha256(("1" * 64 + "2" * 64).encode()).hexdigest()  # as evaluations name them


def make_run(folder, *overrides, episodes=3, summary=None, results=()):
    """Write a run directory and return its folder."""
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(config.dump(config.load(overrides=overrides)))
    rows = [{"episode": n, "finished_as": n, "return": 1.0 * n, "steps": 10, "outcome": "success"} for n in
            range(episodes, 0, -1)]  # fmt: skip
    (folder / "episodes.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    metrics = {"episodes": 1, "replay_low_capacity": 100, "replay_low_size": 5, "replay_low_batch_size": 16}
    (folder / "metrics.jsonl").write_text(json.dumps(metrics | {"mean_return": 3.0}) + "\n")
    if summary is not None:
        (folder / "summary.json").write_text(json.dumps({"weights": WEIGHTS} | FINISHED | summary))
    if results:
        (folder / "evaluation.json").write_text(json.dumps(list(results)))
    return folder
