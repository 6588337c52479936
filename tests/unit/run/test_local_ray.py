import os
import resource
import subprocess
import sys

import pytest

from zsdist import config
from zsdist.errors import RunError
from zsdist.run import local_ray

ADDRESS = """
from zsdist.run import local_ray
local_ray.stay_on_loopback()
import ray
print(ray.util.get_node_ip_address())
"""


def test_ray_on_one_machine_stays_on_loopback_whatever_the_network_is():
    found = subprocess.run([sys.executable, "-c", ADDRESS], capture_output=True, text=True, check=True, env=os.environ)
    assert found.stdout.split() == ["127.0.0.1"]


@pytest.mark.parametrize("actors", [1, 2, 100])
@pytest.mark.parametrize("cores", [1, 2, 16, 512])
def test_ray_starts_no_process_that_a_run_does_not_need_and_no_role_waits_for_a_core(actors, cores):
    settings = config.parse({"run": {"actors": actors}})
    told, processes = local_ray.logical_cores(settings, cores), local_ray.process_count(settings)
    assert settings.run.cpus_per_role * processes <= told <= max(processes, 1)
    assert told >= min(cores, processes)


def test_a_limit_of_open_files_that_is_too_low_is_refused_with_the_number_that_is_needed(monkeypatch):
    hard = 1024
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (256, hard))
    local_ray.check_open_files(config.parse({"run": {"actors": 16}}))
    many = config.parse({"run": {"actors": 1000}})
    with pytest.raises(RunError, match=r"limit of open files is 1024: Ray needs \d+ for \d+ processes"):
        local_ray.check_open_files(many)
    hard = resource.RLIM_INFINITY
    local_ray.check_open_files(many)
