import pytest

from zsdist.roles.scheduler.merge import Merge, Phase
from zsdist.types import Outcome


def make(candidates=("recent", "distilled"), scenes=6, drop_after=2) -> Merge:
    merge = Merge(1, 100, candidates, scenes, drop_after)
    merge.offered([set(candidates), set(candidates)])
    return merge


def drive_all(merge: Merge, good: str) -> None:
    while merge.outstanding():
        name, scene = merge.outstanding()[0]
        merge.drove(name, scene, Outcome.SUCCESS if name == good else Outcome.COLLISION)


@pytest.mark.parametrize("good", ["recent", "distilled", "best"])
def test_the_candidate_that_drives_best_is_chosen(good):
    merge = make(("recent", "distilled", "best"))
    drive_all(merge, good)
    assert merge.phase is Phase.PROMOTE
    assert merge.chosen == good


def test_nothing_is_driven_until_both_levels_have_offered_every_candidate():
    merge = Merge(1, 100, ("recent", "distilled"), 6, 2)
    merge.offered([{"recent", "distilled"}, {"recent"}])
    assert merge.phase is Phase.COLLECT
    assert merge.outstanding() == []


def test_a_hopeless_candidate_is_dropped_early_and_never_chosen():
    merge = make(scenes=20, drop_after=6)
    drive_all(merge, "distilled")
    assert merge.dropped == {"recent"}
    assert len(merge.results["recent"]) < 20
    assert merge.chosen == "distilled"


def test_on_a_tie_the_recent_networks_stay():
    merge = make()
    for name, scene in merge.outstanding():
        merge.drove(name, scene, Outcome.TIMEOUT)
    assert merge.chosen == "recent"


def test_a_repeated_result_counts_once():
    merge = make()
    for _ in range(3):
        merge.drove("recent", 0, Outcome.SUCCESS)
    merge.drove("recent", 0, Outcome.COLLISION)
    assert merge.results["recent"] == {0: Outcome.SUCCESS}


def test_the_comparison_is_kept_in_the_summary():
    merge = make()
    drive_all(merge, "distilled")
    summary = merge.summary()
    assert summary["chosen"] == "distilled"
    assert summary["scores"]["distilled"] == 1.0
    assert summary["scores"]["recent"] < 0
