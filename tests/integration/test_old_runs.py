"""Run directories that an earlier version left behind; `tests/data/run-d869ef6` was made by that commit."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from zsdist.dqn import network
from zsdist.run.checkpoint import load_policy

pytestmark = pytest.mark.integration

OLD_RUN = Path(__file__).parents[1] / "data" / "run-d869ef6"


def lines(file: Path) -> list[dict]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def test_a_run_of_an_earlier_version_is_resumed(tmp_path):
    run = tmp_path / "run"
    shutil.copytree(OLD_RUN, run)
    (run / "figures").mkdir()  # empty folders are not kept under version control
    before = json.loads((run / "summary.json").read_text())
    command = [sys.executable, "-m", "zsdist.launch", "--plain", "--resume", str(run), "--episodes", "6"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    summary, records = json.loads((run / "summary.json").read_text()), lines(run / "episodes.jsonl")
    assert (before["episodes"], summary["episodes"], len(records)) == (4, 6, 6)
    assert records[:4] == lines(OLD_RUN / "episodes.jsonl")
    assert summary["merges"][:2] == before["merges"] and len(summary["merges"]) == 3
    for level, counts in summary["transitions"].items():
        assert counts["stored"] > before["transitions"][level]["stored"]
    assert summary["learner_updates"]["high"] >= before["learner_updates"]["high"]


def test_a_policy_of_an_earlier_version_is_loaded_as_it_was():
    policy = load_policy(OLD_RUN)
    summary = json.loads((OLD_RUN / "summary.json").read_text())
    assert policy.config.run.name == "old"
    assert {level.value: network.sha256(weights) for level, weights in policy.parameters.items()} == summary["weights"][
        "sha256"
    ]
