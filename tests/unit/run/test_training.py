import pytest

from zsdist import config
from zsdist.errors import RunError
from zsdist.run import training


def test_a_level_that_was_not_trained_is_reported_with_the_reason():
    settings = config.parse({"low": {"min_size": 21_000}})
    summary = {"learner_updates": {"high": 7, "low": 0}, "transitions": {"low": {"stored": 900}}}
    (line,) = training.describe_untrained_levels(summary, settings)
    assert "900" in line and "21000 (low.min_size)" in line and "high" not in line


def test_transitions_that_are_neither_stored_nor_rejected_are_an_error():
    training.check_accounts({"transitions": {"low": {"produced": 5, "stored": 4, "rejected": 1}}})
    with pytest.raises(RunError, match="level low do not balance"):
        training.check_accounts({"transitions": {"low": {"produced": 5, "stored": 3, "rejected": 1}}})
