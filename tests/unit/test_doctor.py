import json
import socket

import pytest

from zsdist import doctor
from zsdist.common import cli
from zsdist.doctor import CheckResult, CheckStatus
from zsdist.errors import ZsdistError
from zsdist.roles import permissions
from zsdist.transport import certificates


def run(monkeypatch, findings, *arguments):
    monkeypatch.setattr(doctor, "examine", lambda address, endpoint, tls: iter(findings))
    with pytest.raises(SystemExit) as exit_:
        cli.execute(doctor.main, doctor.make_parser(), arguments)
    return exit_.value.code


GOOD = CheckResult("zenoh", CheckStatus.OK, "a message came through")
THIN = CheckResult("memory", CheckStatus.WARN, "3 GiB", "Use fewer actors.")
BAD = CheckResult("vision", CheckStatus.FAIL, "weights are missing", "Install the package whole.")


def test_a_warning_is_no_failure(monkeypatch, capsys):
    assert run(monkeypatch, [GOOD, THIN]) == 0
    text = capsys.readouterr().out
    assert "ok   zenoh" in text and "warn memory" in text and "Use fewer actors." in text


def test_a_failure_is_status_1_and_says_what_to_do(monkeypatch, capsys):
    assert run(monkeypatch, [GOOD, BAD]) == 1
    text = capsys.readouterr().out
    assert "fail vision: weights are missing" in text and "Install the package whole." in text


def test_json_holds_every_finding(monkeypatch, capsys):
    assert run(monkeypatch, [GOOD, BAD], "--json") == 1
    printed = json.loads(capsys.readouterr().out)
    assert printed["ok"] is False
    assert [check["verdict"] for check in printed["checks"]] == ["ok", "fail"]
    assert set(printed["checks"][0]) == {"check", "verdict", "found", "advice"}


def test_this_python_and_its_packages_are_well():
    assert doctor.check_python().verdict is CheckStatus.OK
    assert [finding.verdict for finding in doctor.check_packages()] == [CheckStatus.OK]


def test_another_python_is_a_failure():
    assert doctor.check_python((3, 13, 1)).verdict is CheckStatus.FAIL


def test_a_missing_and_an_outdated_package_are_named():
    findings = list(doctor.check_packages(["numpy>=2", "no-such-package>=1", "pyyaml<1", "pytest>99; extra == 'dev'"]))
    assert [finding.check for finding in findings] == ["package no-such-package", "package pyyaml"]
    assert "missing" in findings[0].found and "<1" in findings[1].found


def test_too_little_is_a_warning_with_advice():
    finding = doctor.enough("disk", 0.5, 2.0, " GiB", "Make room.")
    assert (finding.verdict, finding.advice) == (CheckStatus.WARN, "Make room.")


def test_an_exception_in_a_check_is_that_checks_failure():
    def broken():
        raise ZsdistError("the camera\nis gone")

    finding = doctor.guarded("camera", broken)
    assert finding.verdict is CheckStatus.FAIL and "the camera is gone" in finding.found


def test_the_camera_and_a_loopback_message_work_here():
    assert doctor.check_camera().verdict is CheckStatus.OK
    assert doctor.check_zenoh().verdict is CheckStatus.OK


def test_a_listening_cluster_address_answers_and_a_closed_one_does_not():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert doctor.check_address(f"ray://127.0.0.1:{port}").verdict is CheckStatus.OK
        assert doctor.check_address(f"127.0.0.1:{port}").verdict is CheckStatus.OK
    closed = doctor.check_address(f"127.0.0.1:{port}")
    assert closed.verdict is CheckStatus.FAIL and closed.advice


def test_auto_means_the_environments_cluster_or_none(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    assert "no Ray cluster" in doctor.check_address("auto").found
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setenv("RAY_ADDRESS", f"127.0.0.1:{server.getsockname()[1]}")
        assert doctor.check_address("auto").verdict is CheckStatus.OK


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/localhost:7447", "tcp/[::1]:7447", "7447"])
def test_an_endpoint_that_others_cannot_reach_fails(endpoint):
    assert doctor.check_endpoint(endpoint).verdict is CheckStatus.FAIL


def test_an_endpoint_with_an_address_of_its_own_is_well():
    assert doctor.check_endpoint("tls/10.0.0.10:7447").verdict is CheckStatus.OK
    plain = doctor.check_endpoint("tcp/10.0.0.10:7447")
    assert plain.verdict is CheckStatus.FAIL and "certificate" in plain.found and "tls/" in plain.advice


def verdicts(folder, endpoint=None):
    return {finding.check: finding.verdict for finding in doctor.check_certificates(folder, endpoint)}


def test_certificates_are_looked_at_one_by_one_and_tried_out(tmp_path):
    certificates.make(tmp_path, permissions.HUB, permissions.client_names(1), ["127.0.0.1"], days=90)
    well = verdicts(tmp_path)
    names = {f"certificate {name}" for name in ("hub", "trusted", "monitor", "actor-0")}
    assert set(well) == names | {"certificate of the hub's host", "zenoh over TLS"}
    assert set(well.values()) == {CheckStatus.OK}
    assert verdicts(tmp_path, "tls/10.0.0.10:7447")["certificate of the hub's host"] is CheckStatus.FAIL
    (tmp_path / "actor-0.key").chmod(0o644)
    (tmp_path / "monitor.key").unlink()
    for file in ("hub.pem", "hub.key"):
        (tmp_path / file).unlink()
    worse = verdicts(tmp_path)
    assert worse == {
        "certificate actor-0": CheckStatus.WARN,
        "certificate monitor": CheckStatus.FAIL,
        "certificate trusted": CheckStatus.OK,
    }


def test_certificates_that_end_soon_are_a_warning_and_none_at_all_a_failure(tmp_path):
    assert list(verdicts(tmp_path).values()) == [CheckStatus.FAIL]
    certificates.make(tmp_path, permissions.HUB, [], ["127.0.0.1"], days=5)
    assert verdicts(tmp_path) == {"certificate hub": CheckStatus.WARN}


def test_without_an_address_no_cluster_is_checked(monkeypatch):
    for name in ("check_camera", "check_vision", "check_zenoh", "check_ray"):
        monkeypatch.setattr(doctor, name, lambda: GOOD)
    alone = [finding.check for finding in doctor.examine(None, None)]
    assert not any(check.startswith(("cluster", "endpoint")) for check in alone)
    both = [finding.check for finding in doctor.examine("127.0.0.1:1", None)]
    assert both[-2:] == ["cluster 127.0.0.1:1", "endpoint tcp/127.0.0.1:7447"]
    assert [finding.check for finding in doctor.examine(None, "rubbish")] == [*alone, "endpoint rubbish"]
