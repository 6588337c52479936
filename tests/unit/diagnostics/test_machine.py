import os
import shutil
import tempfile

import pytest

from zsdist.diagnostics import machine
from zsdist.diagnostics.result import CheckStatus


def test_this_python_and_its_packages_are_well():
    assert machine.check_python().status is CheckStatus.OK
    assert [result.status for result in machine.check_packages()] == [CheckStatus.OK]


def test_another_python_is_a_failure():
    assert machine.check_python((3, 13, 1)).status is CheckStatus.FAIL


def test_a_missing_and_an_outdated_package_are_named():
    results = list(machine.check_packages(["numpy>=2", "no-such-package>=1", "pyyaml<1", "pytest>99; extra == 'dev'"]))
    assert [result.check for result in results] == ["package no-such-package", "package pyyaml"]
    assert "missing" in results[0].found and "<1" in results[1].found


def test_too_little_is_a_warning_with_advice():
    result = machine.compare_amount("disk", 0.5, 2.0, " GiB", "Make room.")
    assert (result.status, result.advice) == (CheckStatus.WARN, "Make room.")


def test_cores_and_memory_are_those_that_are_allowed(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3})
    monkeypatch.setattr(machine, "allowed_memory_bytes", lambda: 2**30)
    cores, memory, _ = machine.check_resources()
    assert (cores.status, cores.found.split(";")[0]) == (CheckStatus.WARN, "1")
    assert (memory.status, memory.found.split(";")[0]) == (CheckStatus.WARN, "1 GiB")


@pytest.mark.parametrize(
    ("free_gib", "total_gib", "status"), [(60, 100, "ok"), (0.5, 2, "warn"), (3, 300, "warn"), (2, 3, "ok")]
)
def test_a_temporary_folder_without_room_is_a_warning(tmp_path, monkeypatch, free_gib, total_gib, status):
    total, free = int(total_gib * 2**30), int(free_gib * 2**30)
    usage = type(shutil.disk_usage(tmp_path))(total, total - free, free)
    monkeypatch.setattr(machine.shutil, "disk_usage", lambda folder: usage)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    result = machine.check_temporary()
    assert (result.status.value, result.found.partition(":")[0]) == (status, str(tmp_path))
    assert ("TMPDIR" in result.advice) is (status == "warn")


@pytest.mark.parametrize(
    ("home", "variables", "status", "words"),
    [
        ("home", {}, CheckStatus.OK, ""),
        ("file", {}, CheckStatus.WARN, "ZSDIST_CACHE to a folder that you can write and that is kept"),
        ("file", {"ZSDIST_CACHE": "stated"}, CheckStatus.OK, ""),
        ("home", {"ZSDIST_CACHE": "file/cache"}, CheckStatus.WARN, "ZSDIST_CACHE to a folder that you can write"),
        (
            "home",
            {"NUMBA_CACHE_DIR": "file/numba"},
            CheckStatus.WARN,
            "Remove the environment variable NUMBA_CACHE_DIR",
        ),
    ],
)
def test_a_cache_that_cannot_be_kept_is_a_warning_with_advice(tmp_path, monkeypatch, home, variables, status, words):
    (tmp_path / "file").write_text("")  # not even root can write into it
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / home))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name in ("ZSDIST_CACHE", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, str(tmp_path / value))
    result = machine.check_cache()
    assert result.status is status and words in result.advice and "make install" not in result.advice
