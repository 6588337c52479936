import dataclasses

import pytest
from fakes import RECORD

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.evaluation import ledger
from zsdist.evaluation.comparison import compare
from zsdist.evaluation.entrants import Entrant
from zsdist.sim import families
from zsdist.types import Outcome

SCENES = [families.draw("iid", "test", index) for index in range(6)]
FAILED = dataclasses.replace(RECORD, outcome=Outcome.COLLISION)


def write(file, records, baseline="astar", seed=0):
    book = ledger.Ledger(file, Entrant(Config(), baseline=baseline), baseline, None, "iid", seed, SCENES)
    for index, record in enumerate(records):
        book.add(index, record)
    return file


def test_differences_are_of_the_same_scenes(tmp_path):
    a = write(tmp_path / "a", [RECORD] * 4 + [FAILED] * 2)
    b = write(tmp_path / "b", [RECORD] * 2 + [FAILED] * 2, "random")
    comparison = compare(a, b)
    success = comparison.result["figures"]["success"]
    assert (success["pairs"], success["a"], success["b"], success["difference"]) == (4, 1.0, 0.5, 0.5)
    assert success["confidence_95"][0] >= 0 and success["confidence_95"][1] <= 1
    assert comparison.result["figures"]["spl"]["difference"] == pytest.approx(0.5 * 0.75)
    assert comparison.notes == [f"{a}: 2 episodes have no partner and are left out"]


def test_pairing_takes_what_is_common_to_all_scenes_out_of_the_interval(tmp_path):
    a = write(tmp_path / "a", [RECORD, FAILED] * 3)
    b = write(tmp_path / "b", [RECORD, FAILED] * 3, "random")
    assert compare(a, b).result["figures"]["success"]["confidence_95"] == [0.0, 0.0]


def test_of_several_policies_in_a_file_a_scene_counts_with_their_mean(tmp_path):
    a = write(tmp_path / "a", [RECORD] * 6)
    write(a, [FAILED] * 6, "potential-field-no-trail")
    b = write(tmp_path / "b", [FAILED] * 6, "random")
    assert compare(a, b).result["figures"]["success"]["a"] == 0.5


def test_scenes_in_which_something_moves_have_no_spl(tmp_path):
    moving = [dataclasses.replace(RECORD, static=False)] * 6
    result = compare(write(tmp_path / "a", moving), write(tmp_path / "b", moving, "random")).result
    assert set(result["figures"]) == {"success", "collision"}


def test_lines_of_older_code_are_left_out_and_said(tmp_path, monkeypatch):
    a = write(tmp_path / "a", [FAILED] * 6)
    monkeypatch.setattr(ledger, "code_sha256", lambda: "newer")
    write(a, [RECORD] * 3)
    comparison = compare(a, write(tmp_path / "b", [RECORD] * 6, "random"))
    assert comparison.result["figures"]["success"]["a"] == 1.0 and comparison.result["episodes"] == 3
    assert any("6 lines of other code than newer" in note for note in comparison.notes)


def test_files_without_a_common_scene_are_refused(tmp_path):
    a, b = write(tmp_path / "a", [RECORD] * 2), write(tmp_path / "b", [RECORD] * 2, "random", seed=1)
    with pytest.raises(RunError, match="no scene, seed and place in common"):
        compare(a, b)


def test_an_empty_file_is_refused(tmp_path):
    (tmp_path / "empty").touch()
    with pytest.raises(RunError, match="holds no episode"):
        compare(tmp_path / "empty", write(tmp_path / "b", [RECORD]))
