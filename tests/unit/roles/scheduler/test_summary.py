import json

import pytest

from zsdist.config import Config
from zsdist.roles.scheduler.summary import run_summary
from zsdist.roles.scheduler.totals import RunTotals
from zsdist.telemetry.snapshot import Snapshot
from zsdist.types import Outcome
from zsdist.wire.messages import State

SUCCESS = {"outcome": "success", "steps": 10, "return": 5.0}
COLLISION = {"outcome": "collision", "steps": 4, "return": -3.0}


@pytest.fixture
def totals():
    totals = RunTotals(Config())
    for count, record in enumerate([SUCCESS, SUCCESS, COLLISION], start=1):
        totals.add_episode(record, count)
    return totals


def test_totals_count_every_episode(totals):
    assert totals.env_steps == 24
    assert totals.outcomes == {Outcome.SUCCESS: 2, Outcome.COLLISION: 1, Outcome.TIMEOUT: 0}
    shown = totals.statistics()
    assert (shown["recent_success"], shown["recent_collision"]) == (0.667, 0.333)
    assert shown["mean_return"] == pytest.approx(7 / 3, abs=1e-3)
    assert shown["average_reward"] == pytest.approx(7 / 24, abs=1e-4)


def test_nothing_is_averaged_before_the_first_episode():
    assert RunTotals(Config()).statistics() == {}


def test_restarts_of_earlier_starts_are_added():
    first = RunTotals(Config())
    assert first.restarts() == {"actor": 0}
    assert first.set_restarts({"actor": 2, "hub": 1})
    assert not first.set_restarts({"actor": 2, "hub": 1})
    second = RunTotals(Config())
    second.restore(json.loads(json.dumps(first.state())))
    assert second.set_restarts({"actor": 1})
    assert second.restarts() == {"actor": 3, "hub": 1}


def test_totals_come_back_from_a_checkpoint(totals):
    merge = {"episode": 2, "candidates": [], "chosen": "recent", "scores": {}, "scenes_driven": {}}
    totals.merges.append(merge)
    state = json.loads(json.dumps(totals.state()))
    restored = RunTotals(Config())
    restored.restore(state)
    assert restored.state() == state
    assert restored.statistics() == totals.statistics()
    assert restored.merges == [merge]


def test_the_summary_adds_up_all_shards_and_names_the_weights(totals):
    def shard(name, stored):
        counts = {"books": {"stored": stored, "rejected": 1}}
        return State(name, {"high": counts, "low": counts}, {})

    def learner(level, version):
        return State(f"learner-{level}", {"version": version, "updates": 7 * version, "sha256": level * 8}, {})

    states = [shard("replay", 5), shard("replay-1", 6), learner("high", 1), learner("low", 2)]
    by_name = {state.role: state for state in states}
    summary = run_summary(totals, by_name, Snapshot(), finished=3, interrupted=True, wall_s=12.0)
    assert summary["transitions"] == {level: {"stored": 11, "rejected": 2} for level in ("high", "low")}
    assert summary["learner_updates"] == {"high": 7, "low": 14}
    assert summary["weights"]["sha256"] == {"high": "high" * 8, "low": "low" * 8}
    assert (summary["episodes"], summary["ended"], summary["restarts"]) == (3, "interrupted", {"actor": 0})
    assert summary["rates"] == {"env_steps_per_s": 2.0, "episodes_per_min": 15.0}
    json.dumps(summary, allow_nan=False)
