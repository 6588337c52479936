"""Real processes that are killed or stopped: the run goes on, and its books balance."""

import signal

import pytest
from revival import Blow, Revival, ride

from zsdist.run import restarts

BLOWS = (
    Blow("learner", "low", signal.SIGKILL),
    Blow("learner", "high", signal.SIGSTOP),
    Blow("hub", "0", signal.SIGSTOP),
    Blow("scheduler", "0", signal.SIGKILL),  # where it is one of `RESTARTED`
)
WITHIN_S = 40.0  # on a busy machine; tests/revival.py measures


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_run_goes_on_whatever_is_killed_or_stopped(tmp_path):
    blows = [blow for blow in BLOWS if blow.role in restarts.RESTARTED]
    revival = Revival("revived", blows)
    summary = ride(tmp_path / "revived", revival)
    assert max(revival.resumed_s) < WITHIN_S
    assert sum(summary["restarts"].values()) == len(blows)
    replaced = [name for event, name in revival.events if event == "role_replaced"]
    assert set(replaced) >= {f"{blow.role}-{blow.identifier}" for blow in blows if blow.role != "hub"}
    for counts in summary["transitions"].values():
        assert counts["produced"] == counts["stored"] + counts["rejected"] > 0
