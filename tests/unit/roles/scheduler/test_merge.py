import pytest

from zsdist.roles.scheduler.merge import Merge, deal_drives, next_merge_at
from zsdist.types import Outcome

ALL = ("recent", "distilled", "best")


def make(candidates=("recent", "distilled"), scenes=6, drop_after=2) -> Merge:
    return Merge(1, 100, candidates, scenes, drop_after)


def drive_all(merge: Merge, outcome) -> Merge:
    """Drive all that is wanted; `outcome` maps a candidate and a scene to the outcome."""
    while merge.outstanding():
        name, scene = merge.outstanding()[0]
        merge.add_result(name, scene, outcome(name, scene), 10)
    return merge


def only(good):
    return lambda name, scene: Outcome.SUCCESS if name == good else Outcome.COLLISION


def fails_on(**scenes):
    return lambda name, scene: Outcome.TIMEOUT if scene in scenes.get(name, ()) else Outcome.SUCCESS


@pytest.mark.parametrize("good", ALL)
def test_the_candidate_that_drives_best_is_chosen(good):
    merge = drive_all(make(ALL), only(good))
    assert merge.chosen == good
    assert merge.outstanding() == []


def test_a_hopeless_candidate_is_dropped_early_and_never_chosen():
    merge = drive_all(make(scenes=20, drop_after=6), only("distilled"))
    assert merge.dropped == {"recent"}
    assert len(merge.results["recent"]) < 20
    assert merge.chosen == "distilled"


def test_on_a_tie_the_recent_networks_stay():
    assert drive_all(make(), fails_on(recent={0}, distilled={1})).chosen == "recent"


@pytest.mark.parametrize(("failures", "chosen"), [(1, "recent"), (4, "recent"), (5, "best"), (8, "best")])
def test_the_last_winner_wins_again_only_where_it_is_better_by_more_than_chance(failures, chosen):
    merge = drive_all(make(ALL, scenes=20, drop_after=20), fails_on(recent=range(failures), distilled=range(failures)))
    assert merge.score("best") > merge.score("recent")
    assert merge.chosen == chosen


def test_what_was_learned_last_is_compared_by_its_score_alone():
    assert drive_all(make(ALL, scenes=20), fails_on(recent={3})).chosen == "distilled"


def test_the_last_winner_is_dropped_once_it_cannot_be_better_by_more_than_chance_any_more():
    merge = drive_all(make(ALL, scenes=20), fails_on())
    assert merge.dropped == {"best"} and merge.chosen == "recent"
    assert len(merge.results["best"]) == 16  # with four scenes left, all wins would be chance still
    assert len(merge.results["recent"]) == len(merge.results["distilled"]) == 20


def test_a_repeated_result_counts_once():
    merge = make()
    for _ in range(3):
        merge.add_result("recent", 0, Outcome.SUCCESS, 7)
    merge.add_result("recent", 0, Outcome.COLLISION, 7)
    assert merge.results["recent"] == {0: Outcome.SUCCESS}
    assert (merge.drives, merge.actions) == (1, 7)


def test_the_comparison_and_its_cost_are_kept_in_the_summary():
    summary = drive_all(make(), only("distilled")).summary(12.5)
    assert summary["chosen"] == "distilled"
    assert summary["scores"]["distilled"] == 1.0
    assert summary["scores"]["recent"] < 0
    driven = sum(summary["scenes_driven"].values())
    assert summary["cost"] == {"seconds": 12.5, "drives": driven, "actions": 10 * driven}


@pytest.mark.parametrize("driven", [0, 5, 11, 60])
def test_a_merge_goes_on_from_its_state_to_the_same_end(driven):
    outcome, whole = fails_on(recent={1, 4, 6}, distilled={2}), make(ALL, scenes=20)
    for name, scene in whole.outstanding()[:driven]:
        whole.add_result(name, scene, outcome(name, scene), 3)
    again = Merge.restored(whole.state())
    assert again == whole
    assert drive_all(again, outcome).summary(1.0) == drive_all(whole, outcome).summary(1.0)


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
