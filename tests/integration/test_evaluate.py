import os
import signal
import subprocess
import sys

import psutil
import pytest

from zsdist.config import Config
from zsdist.evaluation.contenders import Contender
from zsdist.evaluation.workers import drive_all
from zsdist.sim.scenes import families

pytestmark = pytest.mark.integration
PATIENCE_S = 60.0


def test_several_processes_and_one_drive_the_same_trajectories():
    contender, heard = Contender(Config(), baseline="random"), []
    scenes = [families.draw("singleton", "test", index) for index in range(3)]
    alone = drive_all(contender, scenes, seed=4, workers=1, on_record=lambda index, record: None)
    together = drive_all(
        contender, scenes, seed=4, workers=2, on_record=lambda index, record: heard.append((index, record))
    )
    assert [record.poses for record in together] == [record.poses for record in alone]
    assert [record.scene for _, record in sorted(heard, key=lambda one: one[0])] == [scene.name for scene in scenes]


def begin_and_wait_for_progress(*more):
    command = [sys.executable, "-m", "zsdist.evaluate", "random", "--scenes", "iid", "--episodes", "3000", *more]
    process = subprocess.Popen(
        [*command, "--workers", "2"],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert any(line.startswith("random: ") for line in process.stderr)  # a line of progress: the workers drive
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) >= 2
    return process, children


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_process_group_ends_the_command_in_one_line_and_its_workers_too(hears_ctrl_c, tmp_path, number):
    out = tmp_path / "episodes.jsonl"
    process, children = begin_and_wait_for_progress("--out", str(out))
    os.killpg(process.pid, number)
    printed, complaint = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 128 + number
    assert complaint.splitlines()[-1] == f"zsdist.evaluate: interrupted by {number.name}"
    assert "Traceback" not in complaint
    again = printed.splitlines()[-1].split()
    assert "--resume" in again and f"--out={out}" in again
    assert out.read_text().count("\n") > 0 and list(tmp_path.iterdir()) == [out]
    assert psutil.wait_procs(children, timeout=PATIENCE_S)[1] == []


def test_workers_do_not_outlive_a_killed_command():
    process, children = begin_and_wait_for_progress()
    process.kill()
    process.communicate(timeout=PATIENCE_S)
    assert psutil.wait_procs(children, timeout=PATIENCE_S)[1] == []
