import json

import pytest

from zsdist.pretraining.stages import TIME_SHARES, Budget, prune


def test_what_a_stage_leaves_of_its_time_is_for_those_after_it():
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


def test_epochs_that_were_broken_off_before_they_were_saved_are_struck_out(tmp_path):
    history = tmp_path / "training.jsonl"
    lines = [{"stage": stage, "epoch": epoch} for stage in ("words", "head") for epoch in (1, 2, 3)]
    history.write_text("".join(json.dumps(line) + "\n" for line in lines) + '{"stage": "he')
    prune(history, "head", 1)
    assert [json.loads(line) for line in history.read_text().splitlines()] == lines[:4]
