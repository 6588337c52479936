import dataclasses

import numpy as np
import pytest

from zsdist import doctor
from zsdist.common import cli
from zsdist.config import parse
from zsdist.dqn.soundness import UnsoundUpdateError
from zsdist.roles import divergence
from zsdist.roles.rollback import Rollbacks
from zsdist.run import program
from zsdist.types import Batch, Level

CONFIG = parse({"high": {"hidden": [8], "learning_rate": 0.5}, "placement": "inline"})
ROWS = 4


def batch(dqn):
    names = {field.name for field in dataclasses.fields(Batch)}
    assert names >= {"states", "rewards"}
    features, actions = dqn.state()["online/hidden0.weight"].shape[1], len(dqn.parameters()["output.bias"])
    return Batch(
        states=np.zeros((ROWS, features), np.float32),
        actions=np.zeros(ROWS, np.int64),
        rewards=np.array([0, 0, np.nan, 0], np.float32),
        discounts=np.zeros(ROWS, np.float32),
        next_states=np.zeros((ROWS, features), np.float32),
        next_masks=np.ones((ROWS, actions), bool),
        masks=np.ones((ROWS, actions), bool),
        guides=np.full(ROWS, -1),
    )


def run(file):
    with pytest.raises(SystemExit) as exit_:
        cli.execute(doctor.main, doctor.make_parser(), ["--replay-update", str(file)])
    return exit_.value.code


def test_the_command_of_a_refused_update_names_the_first_wrong_number_and_the_likely_setting(tmp_path, capsys):
    dqn = program.make_learner(CONFIG, Level.HIGH)
    dqn.limit = divergence.value_limit(CONFIG, Level.HIGH)
    wrong = batch(dqn)
    with pytest.raises(UnsoundUpdateError) as refused:
        dqn.update(wrong)
    told = Rollbacks(dqn, CONFIG, Level.HIGH, tmp_path).explain(refused.value, wrong, 41)
    (file,) = tmp_path.iterdir()
    assert f"--replay-update {file}" in told
    assert run(file) == 1
    text = capsys.readouterr().out
    assert "fail update: update 42 of the high level: first rewards of the batch: nan at [2], 1 of 4 numbers" in text
    assert "--set high.learning_rate=0.002" in text


def test_a_file_that_is_no_update_is_one_line(tmp_path, capsys):
    assert run(tmp_path / "missing") == 2
    assert "cannot be read" in capsys.readouterr().err
