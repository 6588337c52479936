import os

import pytest

from zsdist.common.allowed_resources import BATCH_VARIABLES, allowed_cores, allowed_memory_bytes

MACHINE_BYTES = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
GIB = 2**30


@pytest.fixture(autouse=True)
def machine_of_64_cores(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(64)))
    for name in BATCH_VARIABLES:
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def mounted(tmp_path):
    """Return a function that writes /proc/self/cgroup and files of cgroups; it returns both mounts."""

    def write(membership, files):
        (tmp_path / "proc" / "self").mkdir(parents=True)
        (tmp_path / "proc" / "self" / "cgroup").write_text(membership)
        for name, content in files.items():
            path = tmp_path / "cgroup" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)
        return tmp_path / "proc", tmp_path / "cgroup"

    return write


def test_affinity_limits_the_cores(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {7})
    assert allowed_cores(tmp_path, tmp_path) == 1


@pytest.mark.parametrize(
    ("membership", "files", "cores"),
    [
        ("0::/\n", {"cpu.max": "200000 100000\n"}, 2),  # a container with a namespace of its own
        ("0::/\n", {"cpu.max": "150000 100000\n"}, 2),
        ("0::/\n", {"cpu.max": "10000 100000\n"}, 1),
        ("0::/\n", {"cpu.max": "max 100000\n"}, 64),
        ("0::/kubepods/pod1/box\n", {"kubepods/pod1/cpu.max": "300000 100000", "kubepods/cpu.max": "max 100000"}, 3),
        ("0::/a/b\n", {"a/b/cpu.max": "800000 100000", "a/cpu.max": "400000 100000", "cpu.max": "max 100000"}, 4),
        ("0::/docker/5f\n", {"cpu.max": "200000 100000"}, 2),  # the path is the host's, the mount the container's
        ("4:cpu,cpuacct:/job\n", {"cpu,cpuacct/job/cpu.cfs_quota_us": "500000", **{
            "cpu,cpuacct/job/cpu.cfs_period_us": "100000"}}, 5),
        ("4:cpu:/\n", {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, 64),
        ("4:cpu:/docker/5f\n1:name=systemd:/x\n0::/\n", {"cpu/cpu.cfs_quota_us": "250000", **{
            "cpu/cpu.cfs_period_us": "100000"}}, 3),
        ("", {}, 64),
    ],
)  # fmt: skip
def test_the_least_quota_of_all_cgroups_around_limits_the_cores(mounted, membership, files, cores):
    assert allowed_cores(*mounted(membership, files)) == cores


@pytest.mark.parametrize(
    ("membership", "files", "allowed"),
    [
        ("0::/\n", {"memory.max": f"{GIB}\n"}, GIB),
        ("0::/\n", {"memory.max": "max\n"}, MACHINE_BYTES),
        ("0::/\n", {"memory.max": "max\n", "memory.high": str(GIB)}, GIB),
        ("0::/a/b\n", {"a/b/memory.max": "max", "a/memory.max": str(GIB)}, GIB),
        ("4:memory:/docker/5f\n", {"memory/memory.limit_in_bytes": str(GIB)}, GIB),
        ("4:memory:/\n", {"memory/memory.limit_in_bytes": "9223372036854771712"}, MACHINE_BYTES),
        ("4:cpu:/\n", {"memory/memory.limit_in_bytes": str(GIB)}, MACHINE_BYTES),
        ("", {}, MACHINE_BYTES),
    ],
)
def test_the_least_limit_of_all_cgroups_around_is_the_memory(mounted, membership, files, allowed):
    assert allowed_memory_bytes(*mounted(membership, files)) == allowed


@pytest.mark.parametrize(("value", "cores"), [("4", 4), ("100", 64), ("0", 1), ("4(x2)", 64), ("", 64)])
@pytest.mark.parametrize("name", BATCH_VARIABLES)
def test_what_slurm_states_limits_the_cores(tmp_path, monkeypatch, name, value, cores):
    monkeypatch.setenv(name, value)
    assert allowed_cores(tmp_path, tmp_path) == cores


def test_this_machine_is_read_without_an_error():
    assert allowed_cores() >= 1 and 0 < allowed_memory_bytes() <= MACHINE_BYTES
