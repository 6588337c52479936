from zsdist.diagnostics import parts, suite
from zsdist.diagnostics.result import CheckResult, CheckStatus


def test_a_cluster_is_checked_where_one_is_named_and_before_what_takes_long(monkeypatch):
    for name in ("check_camera", "check_vision", "check_zenoh", "check_ray"):
        monkeypatch.setattr(parts, name, lambda: CheckResult("part", CheckStatus.OK, "works"))
    alone = [result.check for result in suite.run_checks(None, None)]
    assert not any(check.startswith(("cluster", "endpoint")) for check in alone)
    both = [result.check for result in suite.run_checks("127.0.0.1:1", None)]
    first = alone.index("part")  # of those that take long
    assert both == [*alone[:first], "cluster 127.0.0.1:1", "endpoint tcp/127.0.0.1:7447", *alone[first:]]
    assert [result.check for result in suite.run_checks(None, "rubbish")] == [
        *alone[:first],
        "endpoint rubbish",
        *alone[first:],
    ]
