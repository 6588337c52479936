"""Flow of data at the largest size and after many merges: nothing stands still, and nothing grows."""

import gc
import os
import tracemalloc

import pytest
from flow import Flow, WholeRun

from zsdist.config import parse

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(7200),
    pytest.mark.skipif("ZSDIST_ENDURANCE_DAYS" not in os.environ, reason="takes long; run `make endurance`"),
]

MERGES, DAYS = 1000, 30
MERGE_EVERY = 10  # episodes
SMALL = {"hidden": [4], "min_size": 16}
GROWS = ("*/roles/scheduler/*", "*/telemetry/*")  # lists of finished episodes and merges, which checkpoints contain


def test_4096_actors_go_on(tmp_path):
    level = SMALL | {"updates_per_insert": 0.002}
    config = parse(
        {
            "run": {"actors": 4096, "cars_per_actor": 1},
            "replay": {"batch_initial": 16, "shards": 2},
            "transport": {"mailbox_bytes": 2**30},
            "high": level,
            "low": level,
        }
    )
    flow = Flow(config, tmp_path)
    assert flow.drive(options=3, give_up_s=60.0) == 3
    print(
        f"4096 actors: 3 options each after {flow.now:.1f} s of virtual time"
    )  # the time of 73 steps, and some waiting
    assert all(learner.updates for learner in flow.learners)
    assert not any(outboxes.statistics()["low_resent_frames"] for outboxes in flow.actors.outboxes.values())


def test_a_thousand_merges_hold_no_more_than_ten(tmp_path):
    level = SMALL | {"updates_per_insert": 0.1}
    config = parse(
        {
            "run": {"actors": 2, "cars_per_actor": 3, "episodes": MERGE_EVERY * MERGES + 5},
            "merge": {"every_episodes": MERGE_EVERY, "validation_scenes": 2, "distil_updates": 1},
            "replay": {"batch_initial": 16, "size_initial": 1000},
            "high": level,
            "low": level,
        }
    )
    run, held, bytes_held = WholeRun(config, tmp_path), [], []
    tracemalloc.start()
    try:
        for merges in (10, MERGES // 4, MERGES // 2, MERGES):
            assert run.drive(merges, give_up_s=1e6) == merges
            gc.collect()
            counted = tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(False, name) for name in GROWS])
            bytes_held.append(sum(trace.size for trace in counted.traces))
            held.append(run.held())
    finally:
        tracemalloc.stop()
    growth_mib = (bytes_held[-1] - bytes_held[1]) / 2**20 / (DAYS * 3 / 4)
    print(f"{run.merges} merges: {growth_mib:.4f} MiB a day, events {dict(run.events)}, held {held}")
    assert len(set(held)) == 1
    assert growth_mib < 0.02
    assert run.events["standstill"] == 0 and run.log.checkpoints >= MERGES
