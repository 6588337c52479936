"""Signals to a run in one process; those to Ray's processes are in test_launch.py."""

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.integration

LAUNCH = [sys.executable, "-m", "zsdist.launch", "--single-process", "--actors", "1", "--episodes", "500", "--plain"]
SMALL = ["vision.network=student", "camera.size_px=128", "merge.every_episodes=0", "sim.max_steps=20"]
PATIENCE_S = 100.0


@pytest.fixture
def run(tmp_path):
    """Run that has begun, with its folder; it is killed at the end."""
    folder = tmp_path / "run"
    settings = [word for setting in SMALL for word in ("--set", setting)]
    process = subprocess.Popen(
        [*LAUNCH, *settings, "--run-dir", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with process:
        assert any(line.startswith("[") for line in process.stdout)  # a line of progress
        yield process, folder
        process.kill()


def is_saved(folder):
    return (folder / "summary.json").exists() and any(folder.glob("checkpoints/*/manifest.json"))


def test_a_warning_of_a_batch_system_saves_everything_and_gives_its_status(run):
    process, folder = run
    process.send_signal(signal.SIGUSR1)
    output, complaint = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, complaint) == (128 + signal.SIGUSR1, "")
    assert "SIGUSR1: stopping and saving" in output and f"--resume {folder}" in output
    assert is_saved(folder)


def test_a_run_whose_output_nobody_reads_any_longer_saves_everything_and_says_so_elsewhere(run):
    process, folder = run
    process.stdout.close()  # as `launch | head` does
    complaint = process.stderr.read()
    assert (process.wait(PATIENCE_S), "Traceback" in complaint) == (141, False)
    assert f"--resume {folder}" in complaint
    assert is_saved(folder)
