import os
from collections import Counter

import pytest
from storm import Storm
from whole_storm import MORTAL, WholeStorm

from zsdist.replay import journal

SEEDS = int(os.environ.get("ZSDIST_STORMS", "40"))  # `ZSDIST_STORMS=1000` for the full test
CASES = 8
WHOLE_SHARE = 10  # storms of the push protocol for each of a whole run, which takes seconds


@pytest.mark.parametrize("case", range(CASES))
def test_nothing_is_lost_or_doubled_whatever_dies_and_however_bad_the_network_is(case, tmp_path, monkeypatch):
    monkeypatch.setattr(journal, "COMPACT_RECORDS", 12 + 6 * case)  # so that journals are compacted often
    deaths, sampled, recovered = {"replay": 0, "actor": 0, "partition": 0}, 0, 0
    for seed in range(case, SEEDS, CASES):
        storm = Storm(seed, tmp_path / str(seed), shards=1 + seed // CASES % 2)
        storm.ride()
        storm.check()
        for kind, count in storm.deaths.items():
            deaths[kind] += count
        sampled += storm.sampled
        recovered += storm.recovered
    assert min(deaths.values()) > 0, f"too few faults to show anything: {deaths}"
    assert sampled > 0 and recovered > 0


@pytest.mark.parametrize("case", range(max(1, SEEDS // WHOLE_SHARE)))
def test_a_whole_run_ends_with_balanced_books_whichever_roles_die_and_whatever_their_clocks_say(
    case, tmp_path, monkeypatch
):
    monkeypatch.setattr(journal, "COMPACT_RECORDS", 40)
    storm = WholeStorm(case, tmp_path, 1 + case % 2)
    storm.ride()
    storm.check()
    assert min(Counter({kind: storm.deaths[kind] for kind in MORTAL}).values()) > 0, f"too few deaths: {storm.deaths}"
