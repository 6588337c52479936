import shlex

from zsdist import certs
from zsdist.diagnostics.certificates import check_certificates
from zsdist.diagnostics.result import CheckStatus
from zsdist.roles import permissions
from zsdist.transport import certificates


def statuses(folder, endpoint=None):
    return {result.check: result.status for result in check_certificates(folder, endpoint)}


def test_certificates_are_looked_at_one_by_one_and_tried_out(tmp_path):
    certificates.make(tmp_path, permissions.HUB, permissions.client_names(1), ["127.0.0.1"], days=90)
    well = statuses(tmp_path)
    roles = ("learner-high", "learner-low", "replay")
    names = {f"certificate {name}" for name in ("hub", "trusted", "monitor", "actor-0", *roles)}
    assert set(well) == names | {"certificate of the hub's host", "zenoh over TLS"}
    assert set(well.values()) == {CheckStatus.OK}
    assert statuses(tmp_path, "tls/10.0.0.10:7447")["certificate of the hub's host"] is CheckStatus.FAIL
    (tmp_path / "actor-0.key").chmod(0o644)
    (tmp_path / "monitor.key").unlink()
    for file in ("hub.pem", "hub.key"):
        (tmp_path / file).unlink()
    worse = statuses(tmp_path)
    assert worse == {
        "certificate actor-0": CheckStatus.WARN,
        "certificate monitor": CheckStatus.FAIL,
        "certificate trusted": CheckStatus.OK,
        **{f"certificate {name}": CheckStatus.OK for name in roles},
    }


def test_certificates_that_end_soon_are_a_warning_and_none_at_all_a_failure(tmp_path):
    assert list(statuses(tmp_path).values()) == [CheckStatus.FAIL]
    certificates.make(tmp_path, permissions.HUB, [], ["127.0.0.1"], days=5)
    (tmp_path / "._hub.pem").write_bytes(b"\x00")  # as an archive made on a Mac has it
    assert statuses(tmp_path) == {"certificate hub": CheckStatus.WARN}


def test_every_advice_is_a_command_that_the_shell_and_its_parser_read_back(tmp_path):
    folder = tmp_path / "my keys[/x] #1"
    certificates.make(folder, permissions.HUB, permissions.client_names(20), ["127.0.0.1", "10.1.2.3"], days=5)
    (folder / "actor-19.key").unlink()
    (folder / "trusted.key").chmod(0o644)
    advice = {result.check: result.advice for result in check_certificates(folder, "tls/10.9.9.9:7447")}
    assert shlex.split(advice["certificate trusted"]) == ["chmod", "600", str(folder / "trusted.key")]
    for check, name in (("certificate actor-19", "actor-19"), ("certificate of the hub's host", "hub")):
        removal, making = advice[check].split(" && ")
        assert shlex.split(removal) == ["rm", str(folder / f"{name}.pem"), str(folder / f"{name}.key")]
        options = certs.make_parser().parse_args(shlex.split(making)[3:])
        assert options.folder == folder
        if name == "hub":
            assert {"10.1.2.3", "10.9.9.9"} <= set(options.host)
        else:
            assert options.actors == 20
    (empty,) = check_certificates(tmp_path / "no keys", None)
    assert certs.make_parser().parse_args(shlex.split(empty.advice.removeprefix("Run "))[3:]).folder.name == "no keys"
