import pytest

from zsdist.roles.scheduler.merge import Merge, deal_drives, next_merge_at
from zsdist.roles.schemas import Phase
from zsdist.types import Outcome


def make(candidates=("recent", "distilled"), scenes=6, drop_after=2) -> Merge:
    merge = Merge(1, 100, candidates, scenes, drop_after)
    merge.start_drives([set(candidates), set(candidates)])
    return merge


def drive_all(merge: Merge, good: str) -> None:
    while merge.outstanding():
        name, scene = merge.outstanding()[0]
        merge.add_result(name, scene, Outcome.SUCCESS if name == good else Outcome.COLLISION)


@pytest.mark.parametrize("good", ["recent", "distilled", "best"])
def test_the_candidate_that_drives_best_is_chosen(good):
    merge = make(("recent", "distilled", "best"))
    drive_all(merge, good)
    assert merge.phase is Phase.PROMOTE
    assert merge.chosen == good


def test_no_drive_is_wanted_until_both_levels_have_offered_every_candidate():
    merge = Merge(1, 100, ("recent", "distilled"), 6, 2)
    merge.start_drives([{"recent", "distilled"}, {"recent"}])
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
        merge.add_result(name, scene, Outcome.TIMEOUT)
    assert merge.chosen == "recent"


def test_a_repeated_result_counts_once():
    merge = make()
    for _ in range(3):
        merge.add_result("recent", 0, Outcome.SUCCESS)
    merge.add_result("recent", 0, Outcome.COLLISION)
    assert merge.results["recent"] == {0: Outcome.SUCCESS}


def test_the_comparison_is_kept_in_the_summary():
    merge = make()
    drive_all(merge, "distilled")
    summary = merge.summary()
    assert summary["chosen"] == "distilled"
    assert summary["scores"]["distilled"] == 1.0
    assert summary["scores"]["recent"] < 0


def merges(every, target):
    """Return the counts of finished episodes at which a run has its merges."""
    last, found = 0, []
    while last < target and (due := next_merge_at(last, every, target)) <= target:
        found.append(due)
        last = due
    return found


@pytest.mark.parametrize(
    ("every", "target", "expected"),
    [
        (4, 8, [4, 8]),
        (4, 9, [4, 8]),  # the last episode alone gives no merge
        (4, 10, [4, 8, 10]),  # half of `every` has passed at the end
        (4, 11, [4, 8, 11]),
        (5, 7, [5]),
        (5, 8, [5, 8]),
        (100, 30, []),
        (100, 50, [50]),
        (1, 3, [1, 2, 3]),
        (0, 8, []),
    ],
)
def test_merges_are_due_at_the_multiples_and_at_the_end_where_half_has_passed(every, target, expected):
    assert merges(every, target) == expected


@pytest.mark.parametrize("every", [1, 2, 3, 7, 50])
@pytest.mark.parametrize("target", [1, 10, 49, 100])
def test_no_two_merges_are_further_apart_or_much_closer_than_configured(every, target):
    gaps = [later - earlier for earlier, later in zip([0, *merges(every, target)], merges(every, target), strict=False)]
    assert all(every / 2 <= gap <= every for gap in gaps)


def test_a_merge_after_a_resume_with_other_settings_is_due_at_the_next_multiple():
    assert next_merge_at(7, 5, 100) == 10
    assert next_merge_at(8, 5, 12) == 10


CANDIDATES = ("recent", "distilled", "best")


def test_every_outstanding_drive_is_dealt_to_one_actor_and_evenly():
    outstanding = [(name, scene) for scene in range(8) for name in CANDIDATES]
    dealt = deal_drives(outstanding, CANDIDATES, ["a", "b", "c"])
    assert sorted(drive for drives in dealt.values() for drive in drives) == sorted(outstanding)
    assert {len(drives) for drives in dealt.values()} == {8}


def test_a_drive_stays_with_its_actor_while_others_finish():
    outstanding = [(name, scene) for scene in range(8) for name in CANDIDATES]
    before = deal_drives(outstanding, CANDIDATES, ["a", "b"])
    after = deal_drives(outstanding[5:], CANDIDATES, ["a", "b"])
    for actor, drives in after.items():
        assert drives == [drive for drive in before[actor] if drive in outstanding[5:]]


def test_actors_without_drives_get_an_empty_list():
    assert deal_drives([], CANDIDATES, ["a", "b"]) == {"a": [], "b": []}
    assert deal_drives([], (), []) == {}
