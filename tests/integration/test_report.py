"""A report and a film of a run with physics and camera in one process."""

import subprocess
import sys

import cv2
import pytest

pytestmark = [pytest.mark.integration, pytest.mark.slow]

SMALL = ["--set", "run.final_evaluation_episodes=0", "--set", "sim.max_steps=40"]


def command(*arguments):
    done = subprocess.run([sys.executable, "-m", *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_run_becomes_a_report_with_paths_and_its_policy_a_film(tmp_path):
    run, page, films = tmp_path / "run", tmp_path / "page", tmp_path / "films"
    command("zsdist.launch", "--single-process", "--plain", "--episodes", 3, "--run-dir", run, *SMALL)
    told = command("zsdist.evaluate", run, "--scenes", "ood-layout", "--episodes", 2, "--json", run / "layout.json",
                   "--video", films, "--video-episodes", 1)  # fmt: skip
    (film,) = films.glob("*.mp4")
    assert f"film: {film}" in told
    reader = cv2.VideoCapture(str(film))
    assert reader.read()[0] and reader.get(cv2.CAP_PROP_FRAME_COUNT) > 20
    assert f"{page / 'report.md'}" in command("zsdist.report", run, "--out", page)
    text = (page / "report.md").read_text()
    assert "(fig10-guidance.png)" in text and "(fig12-paths.png)" in text
    assert "| `ood-layout` | default |" in text
