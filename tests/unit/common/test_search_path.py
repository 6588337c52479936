import os
import subprocess
import sys
from pathlib import Path

import pytest

import zsdist
from zsdist.common.search_path import leave_out_working_folder

HOME = str(Path(zsdist.__file__).parents[1])
COMMAND = ["python", "-m", "zsdist.launch", "--actors", "2"]
SCRIPT = ["/home/me/.venv/bin/python", "/home/me/.venv/bin/zsdist", "launch"]
WORKER = ["python", "-u", "/site-packages/ray/_private/workers/default_worker.py", "--node-ip-address=127.0.0.1"]


def test_modules_of_a_user_in_the_working_folder_take_no_place_of_a_library(tmp_path):
    for name in ("random", "copy", "logging", "numpy", "yaml", "ray", "torch", "zenoh", "gymnasium", "zsdist_notes"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('a file of the user was imported')\n")
    command = [sys.executable, "-m", "zsdist.evaluate", "--list"]
    found = subprocess.run(command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": HOME}, capture_output=True, text=True)
    assert (found.returncode, found.stderr) == (0, "")
    assert "pretrained" in found.stdout


@pytest.mark.parametrize("first", ["", "/home/me"])
@pytest.mark.parametrize("arguments", [COMMAND, SCRIPT, [*COMMAND[:2], "zsdist", "launch"], WORKER])
def test_commands_and_workers_leave_the_working_folder_out_once(first, arguments):
    path = [first, "/home/me", "/lib"]
    leave_out_working_folder(path, arguments, "/home/me", HOME)
    assert path == ["/home/me", "/lib"]  # the second was asked for by PYTHONPATH


@pytest.mark.parametrize("arguments", [["python", "mine.py"], ["python", "-m", "mine"], ["python", "-m", "pytest"]])
def test_a_program_that_imports_the_package_keeps_its_path(arguments):
    path = ["", "/lib"]
    leave_out_working_folder(path, arguments, "/home/me", HOME)
    assert path == ["", "/lib"]


def test_a_checkout_that_is_not_installed_is_found_from_its_own_folder():
    path = [HOME, "/lib"]
    leave_out_working_folder(path, COMMAND, HOME, HOME)
    assert path == [HOME, "/lib"]
