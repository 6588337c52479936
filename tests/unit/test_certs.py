import shlex

import pytest

from zsdist import certs
from zsdist.common import cli
from zsdist.roles import permissions
from zsdist.transport.certificates import Identity


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        cli.execute(certs.main, certs.make_parser(), list(map(str, arguments)))
    return ended.value.code, capsys.readouterr()


def test_every_role_of_a_run_finds_its_certificate(capsys, tmp_path):
    status, printed = run(capsys, tmp_path / "made", "--actors", "2", "--host", "10.1.2.3", "--days", "3")
    assert status == 0
    roles = [("hub", "0"), ("scheduler", "0"), ("replay", "0"), ("replay", "1"), ("supervisor", "0")]
    roles += [("learner", "low"), ("learner", "high")]
    for role, identifier in [*roles, ("monitor", "0"), ("actor", "0"), ("actor", "1")]:
        Identity.load(tmp_path / "made", permissions.certificate_of(role, identifier))
    hosts = Identity.load(tmp_path / "made", permissions.HUB).hosts()
    assert {"127.0.0.1", "localhost", "10.1.2.3"} <= set(hosts)
    assert "10.1.2.3" in printed.out and "ca.key" in printed.out


def test_a_second_call_adds_actors_and_reports_that_the_hubs_certificate_stays(capsys, tmp_path):
    run(capsys, tmp_path, "--actors", "1")
    status, printed = run(capsys, tmp_path, "--actors", "2", "--host", "10.1.2.3")
    assert status == 0
    assert "made actor-1 " in printed.out and "delete hub.pem" in printed.out


@pytest.mark.parametrize("name", ["my keys", "a#b", "tls[/x]", "it's", "-k"])
def test_the_option_that_uses_the_certificates_is_read_back_by_the_shell(capsys, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    _, printed = run(capsys, *(["--", name] if name.startswith("-") else [name]))
    (line,) = [line for line in printed.out.splitlines() if "--set" in line]
    assert shlex.split(line) == ["--set", f"transport.tls={tmp_path / name}"]


@pytest.mark.parametrize(("option", "value"), [("--actors", "0"), ("--days", "9999999")])
def test_an_impossible_count_is_refused_in_one_line(capsys, tmp_path, option, value):
    status, printed = run(capsys, tmp_path / "made", option, value)
    assert status == cli.REFUSED
    assert value in printed.err and printed.err.count("\n") == 1
    assert not (tmp_path / "made").exists()
