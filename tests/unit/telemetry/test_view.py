import pytest
from made_snapshots import RUN, alive, extreme, made, report

from zsdist.telemetry.curves import CurveHistory
from zsdist.telemetry.snapshot import Snapshot
from zsdist.telemetry.view import LINE_LENGTH, Clock, duration, view_of


def test_figures_are_shown_under_their_headings():
    snapshot = made(
        report("scheduler", "0", stage="train", episodes=7, episodes_target=20, drives_left=3, epsilon=0.25,
               recent_success=0.5, success=4, collision=2, timeout=1, merges=1, restarts=2),
        report("learner", "low", weight_version=9, learner_updates=30, loss=0.125),
        report("actor", "0", low_weight_version=7, env_steps=120),
        report("replay", "0", low_size=50, low_batch_size=16),
        alive("actor", "0"),
    )  # fmt: skip
    view = view_of(RUN, snapshot, Clock(1.0))
    assert (view.episodes, view.target, view.state) == (7, 20, "train, merge: 3 drives left")
    figures = {"success": "0.50", "success collision timeout": "4 2 1", "epsilon": "0.25", "updates": "high 0 low 30",
               "loss": "high - low 0.1250", "weight lag": "high 0 low 2", "replay": "high 0 low 50", "batch": "16",
               "merges": "1", "restarts": "2", "roles alive": "1"}  # fmt: skip
    assert figures.items() <= view.figures.items()
    assert view.waiting == "nothing"


def test_before_any_statistics_every_heading_has_a_text_and_the_roles_that_start_are_named():
    view = view_of(RUN, Snapshot(), Clock(0.0), expected=["scheduler-0", "actor-0"])
    assert view.stage == "starting" and view.target is None and all(view.figures.values())
    assert view.waiting == "for the first of 2 roles"
    assert [(line.name, line.health) for line in view.roles] == [("scheduler-0", "starting"), ("actor-0", "starting")]


def test_a_start_names_the_roles_that_are_not_there_yet():
    expected = ["scheduler-0", *(f"actor-{number}" for number in range(9))]
    snapshot = made(report("scheduler", "0", stage="train", episodes=0), report("actor", "0"))
    view = view_of(RUN, snapshot, Clock(9.0), expected=expected)
    assert view.stage == "starting" and view.waiting.endswith("and 4 more (2 of 10 roles are there)")
    assert "actor-1 actor-2" in view.waiting
    snapshot.update([report("actor", "0", env_steps=1)])  # the first car drives: it has begun
    assert view_of(RUN, snapshot, Clock(9.0), expected=expected).stage == "train"


def test_a_stage_says_which_states_it_waits_for():
    snapshot = made(report("scheduler", "0", stage="saving", drives_left=0, states_awaited="replay-0 learner-low"))
    assert view_of(RUN, snapshot, Clock(1.0)).state == "saving, saving: replay-0 learner-low not there yet"


def waiting_run(stage, silent_s=0.0):
    snapshot = Snapshot()
    for second in range(3):
        snapshot.update([
            report("scheduler", "0", second, stage=stage),
            report("actor", "0", second, env_steps=40 * second),
            report("learner", "low", second, learner_updates=30 * second, waiting_data_s=0.9 * second),
        ])  # fmt: skip
    return view_of(RUN, snapshot, Clock(2.0, silent_s))


def test_rates_of_the_past_are_not_shown_and_the_silence_is():
    view = waiting_run("train")
    assert view.figures["env steps/s"] == "40" and "low 30" in view.figures["updates/s"]
    assert view.waiting == "learner low for data"
    view = waiting_run("train", silent_s=25.0)
    assert view.figures["env steps/s"] == view.figures["updates/s"] == view.figures["roles alive"] == "-"
    assert "25 s ago" in view.waiting and "learner" not in view.waiting


@pytest.mark.parametrize("stage", ["closing", "saving", "done"])
def test_nobody_waits_for_data_once_the_training_has_ended(stage):
    assert "learner" not in waiting_run(stage).waiting


def test_roles_in_trouble_come_first():
    names = [("actor", "10"), ("actor", "2"), ("learner", "low"), ("actor", "3")]
    snapshot = made(*(report(*name) for name in names), *(alive(*name) for name in names[:3]), alive("hub", "0"))
    silent_s = {("actor", "10"): 12.0, ("actor", "3"): 9.0}
    roles = view_of(RUN, snapshot, Clock(1.0), silent_s=silent_s).roles
    assert [(line.name, line.health) for line in roles] == [
        ("actor-3", "gone"), ("actor-10", "silent 12 s"), ("learner-low", "ok"), ("hub-0", "starting"),
        ("actor-2", "ok"),
    ]  # fmt: skip


def test_no_line_is_longer_than_it_may_be():
    snapshot = extreme()
    for clock in (Clock(10.0**7), Clock(10.0**7, 3600.0), Clock(10.0**7, known=False)):
        line = view_of("r" * 64, snapshot, clock, expected=[f"actor-{number}" for number in range(5000)]).line()
        assert len(line) <= LINE_LENGTH and line.isprintable()
        assert "episodes 99999/100000" in line and "waiting " in line


def test_the_time_left_follows_from_the_newest_pace():
    history = CurveHistory({"time_s": [0.0, 60.0, 120.0], "episodes": [0, 10, 20], "recent_success": [None, 0.1, 0.2]})
    snapshot = made(report("scheduler", "0", stage="train", episodes=20, episodes_target=50))
    assert view_of(RUN, snapshot, Clock(120.0), history=history).left_s == 180.0
    assert view_of(RUN, snapshot, Clock(120.0, 60.0), history=history).left_s is None  # it is silent
    assert history.points("recent_success") == [(10, 0.1), (20, 0.2)]


def test_durations_are_read_at_a_glance():
    assert [duration(seconds) for seconds in (5, 65, 3725)] == ["5 s", "1 min 05 s", "1 h 02 min"]
