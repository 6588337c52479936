import pytest

from zsdist.pretraining.stages import TIME_SHARES, Budget


def test_time_that_a_stage_does_not_use_goes_to_later_stages():
    now = [0.0]
    budget = Budget(100.0, ["pictures", "head", "student"], lambda: now[0])
    used = budget.begin("pictures")
    now[0] = 10.0
    share = TIME_SHARES["pictures"] / (1.0 - TIME_SHARES["words"])
    assert used() == pytest.approx(0.1 / share)
    used = budget.begin("head")
    head, student = TIME_SHARES["head"], TIME_SHARES["student"]
    now[0] = 10.0 + 90.0 * head / (head + student)  # of the 90 seconds that are left
    assert used() == pytest.approx(1.0)
    used = budget.begin("student")
    now[0] = 100.0
    assert used() == pytest.approx(1.0)
