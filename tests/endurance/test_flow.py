"""Flow of data at the largest size and after many merges: nothing stands still, and nothing grows."""

import gc
import os
import sys
import time

import pytest
from endurance.conftest import BYTES_OF_AN_OBJECT, MIB
from flow import Flow, WholeRun

from zsdist.config import parse

MONTH = pytest.mark.skipif("ZSDIST_ENDURANCE_DAYS" not in os.environ, reason="takes long; run `make endurance`")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(7200)]

ACTORS, OPTIONS = 4096, 3
MERGES, DAYS = 1000, 30
MERGE_EVERY = 10  # episodes
SMALL = {"hidden": [4], "min_size": 16}


def flow_of(actors, folder):
    level = SMALL | {"updates_per_insert": 0.002}
    settings = {
        "run": {"actors": actors, "cars_per_actor": 1},
        "replay": {"batch_initial": 16, "shards": 2},
        "transport": {"mailbox_bytes": 2**30},
        "high": level,
        "low": level,
    }
    return Flow(parse(settings), folder)


def run_of(actors, folder, merges, **merge):
    level = SMALL | {"updates_per_insert": 0.1}
    every = merge["every_episodes"]
    settings = {
        "run": {"actors": actors, "cars_per_actor": 3 if actors < 10 else 1, "episodes": every * merges + every // 2},
        "merge": {"validation_scenes": 2, "distil_updates": 1} | merge,
        "replay": {"batch_initial": 16, "size_initial": 1000},
        "transport": {"mailbox_bytes": 2**28},
        "high": level,
        "low": level,
    }
    return WholeRun(parse(settings), folder)


@pytest.mark.parametrize("actors", [64, pytest.param(ACTORS, marks=MONTH)])
def test_many_actors_go_on(tmp_path, report, actors):
    began_s, flow = time.process_time(), flow_of(actors, tmp_path)
    for options in range(1, OPTIONS + 1):
        assert flow.drive(options, give_up_s=60.0) == options
        report(actors=actors, options=options, virtual_s=flow.now, processor_s=time.process_time() - began_s)
    assert all(learner.updates for learner in flow.learners)
    assert not any(outboxes.statistics()["low_resent_frames"] for outboxes in flow.actors.outboxes.values())


@pytest.mark.parametrize("actors", [32, pytest.param(ACTORS, marks=MONTH)])
def test_a_scheduler_of_many_actors_leases_merges_and_goes_on(tmp_path, report, actors):
    began_s, run = time.process_time(), run_of(actors, tmp_path, 3, every_episodes=2 * actors)
    for merges in (1, 2):
        assert run.drive(merges, give_up_s=300.0) == merges
        report(actors=actors, merges=merges, virtual_s=run.now, processor_s=time.process_time() - began_s)
    assert run.events["standstill"] == 0
    assert 4 * actors <= run.scheduler.finished_episodes <= 6 * actors  # training goes on beside a merge


@pytest.mark.parametrize("merges", [8, pytest.param(MERGES, marks=MONTH)])
def test_a_thousand_merges_hold_no_more_than_ten(tmp_path, report, merges):
    run, held, blocks, began_s = run_of(2, tmp_path, merges, every_episodes=MERGE_EVERY), [], [], time.process_time()
    for reached in (merges // 4, merges // 2, *range(merges // 2 + 50, merges, 50), merges):
        assert run.drive(reached, give_up_s=1e6) == reached
        gc.collect()
        blocks.append(sys.getallocatedblocks())
        held.append(run.held())
        report(merges=reached, virtual_s=run.now, processor_s=time.process_time() - began_s, objects=blocks[-1])
    grown_mib = (blocks[-1] - blocks[1]) * BYTES_OF_AN_OBJECT / MIB  # the lists of a checkpoint among it
    report(mib_a_day=grown_mib / (DAYS * merges / MERGES / 2), standstills=run.events["standstill"])
    assert len(set(held)) == 1
    assert run.events["standstill"] == 0 and run.log.checkpoints >= merges - 1  # that of the last is under way
    assert merges < MERGES or grown_mib / (DAYS / 2) < 1
