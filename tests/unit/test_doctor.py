import json

import pytest

from zsdist import doctor
from zsdist.common import cli
from zsdist.diagnostics import suite
from zsdist.diagnostics.result import CheckResult, CheckStatus


def run(monkeypatch, results, *arguments):
    monkeypatch.setattr(suite, "run_checks", lambda address, endpoint, tls: iter(results))
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


def test_json_holds_every_result(monkeypatch, capsys):
    assert run(monkeypatch, [GOOD, BAD], "--json") == 1
    printed = json.loads(capsys.readouterr().out)
    assert printed["ok"] is False
    assert [check["verdict"] for check in printed["checks"]] == ["ok", "fail"]
    assert set(printed["checks"][0]) == {"check", "verdict", "found", "advice"}
