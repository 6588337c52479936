from zsdist.diagnostics import parts, suite
from zsdist.diagnostics.result import CheckResult, CheckStatus


def test_without_an_address_no_cluster_is_checked(monkeypatch):
    for name in ("check_camera", "check_vision", "check_zenoh", "check_ray"):
        monkeypatch.setattr(parts, name, lambda: CheckResult("part", CheckStatus.OK, "works"))
    alone = [result.check for result in suite.run_checks(None, None)]
    assert not any(check.startswith(("cluster", "endpoint")) for check in alone)
    both = [result.check for result in suite.run_checks("127.0.0.1:1", None)]
    assert both[-2:] == ["cluster 127.0.0.1:1", "endpoint tcp/127.0.0.1:7447"]
    assert [result.check for result in suite.run_checks(None, "rubbish")] == [*alone, "endpoint rubbish"]
