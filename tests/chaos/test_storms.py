import os

import pytest
from storm import Storm

from zsdist.replay import journal

SEEDS = int(os.environ.get("ZSDIST_STORMS", "40"))  # `ZSDIST_STORMS=1000` for the full test
CASES = 8


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
