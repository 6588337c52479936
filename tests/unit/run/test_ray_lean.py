import re
import subprocess
import sys
from pathlib import Path

import pytest

from zsdist.run import local_ray, nursery_shim

CONSTRAINTS = Path(__file__).parents[3] / "constraints.txt"
STARTED = """
import psutil
from zsdist.run import local_ray
local_ray.stay_on_loopback()
from zsdist.config import Config
from zsdist.run import ray
ray.connect(Config())
for process in psutil.Process().children(recursive=True):
    print(process.cmdline(), flush=True)
"""

local_ray.stay_on_loopback()
from zsdist.run import ray_lean  # noqa: E402 (Ray reads the environment at its import)


def test_the_release_in_the_constraints_was_tried():
    (version,) = re.findall(r"^ray==(\S+)$", CONSTRAINTS.read_text(), re.MULTILINE)
    assert version.startswith(ray_lean.RELEASES)


def test_another_release_starts_whole(monkeypatch):
    monkeypatch.setattr(ray_lean, "RELEASES", ("1.0.",))
    before = ray_lean.node.Node.start_monitor
    with ray_lean.lean():
        assert ray_lean.node.Node.start_monitor is before


def test_everything_is_restored():
    before = ray_lean.services.start_ray_process, ray_lean.node.Node.start_log_monitor
    with ray_lean.lean():
        assert ray_lean.services.start_ray_process is not before[0]
    assert (ray_lean.services.start_ray_process, ray_lean.node.Node.start_log_monitor) == before


@pytest.mark.integration
@pytest.mark.skipif(not ray_lean.is_tried(), reason="this release of Ray starts whole")
def test_ray_starts_only_what_a_run_uses():
    done = subprocess.run([sys.executable, "-c", STARTED], capture_output=True, text=True, check=True)
    commands = done.stdout.splitlines()
    named = [word for word in ("gcs_server", "raylet", "ray_agent") if any(word in line for line in commands)]
    assert named == ["gcs_server", "raylet", "ray_agent"]
    for unused in ("monitor.py'", "log_monitor.py", "dashboard.py'", "agent.py', '--node-id"):
        assert [line for line in commands if unused in line and "raylet'" not in line] == []


def test_the_shim_finds_rays_own_setup():
    folder = Path(ray_lean.services.__file__).parent / "workers"
    assert (folder / nursery_shim.SETUP).is_file()
