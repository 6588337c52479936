import pytest

from zsdist import config
from zsdist.errors import RunError
from zsdist.run import training
from zsdist.wire.messages import State


def test_a_level_that_was_not_trained_is_reported_with_the_reason():
    settings = config.parse({"low": {"min_size": 21_000}})
    summary = {"learner_updates": {"high": 7, "low": 0}, "transitions": {"low": {"stored": 900}}}
    (line,) = training.describe_untrained_levels(summary, settings, {})
    assert "900" in line and "21000 (low.min_size)" in line and "high" not in line


@pytest.mark.parametrize(
    ("now", "setting", "reason"),
    [
        (8, {}, None),
        (7, {"updates_per_insert": 0.01}, "60 transitions were added, for 0.01 updates each"),
        (7, {}, "60 transitions were added, and the run ended before any update"),
        (7, {"min_size": 2000}, "starts at 2000"),
    ],
)
def test_a_resumed_run_that_did_not_train_since_says_so_whatever_it_learned_before(now, setting, reason):
    states = {
        "learner-low": State("learner-low", {"updates": 7}, {}),
        "replay": State("replay", {"low": {"stored": 840}}, {}),
    }
    summary = {"learner_updates": {"low": now}, "transitions": {"low": {"stored": 900}}}
    lines = training.describe_untrained_levels(summary, config.parse({"low": setting}), states)
    if reason is None:
        assert lines == []
    else:
        (line,) = lines
        assert "the low level was not trained since it was resumed" in line and reason in line


def test_transitions_that_are_neither_stored_nor_rejected_are_an_error():
    training.check_accounts({"transitions": {"low": {"produced": 5, "stored": 4, "rejected": 1}}})
    with pytest.raises(RunError, match="level low do not balance"):
        training.check_accounts({"transitions": {"low": {"produced": 5, "stored": 3, "rejected": 1}}})
