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
