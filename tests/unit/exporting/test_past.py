import json

import pytest
from bundles import small_policy
from made_runs import RESULT

from zsdist.errors import RunError
from zsdist.exporting.past import evaluations_of, training_of


@pytest.fixture(scope="module")
def policy():
    return small_policy()


def result(policy, **changes):
    return RESULT | {"weights_sha256": policy.sha256, "variant": "full"} | changes


def write(path, content):
    path.write_text(json.dumps(content))
    return path


def test_the_training_is_that_of_the_checkpoint(policy):
    assert training_of(policy)["episodes"] == 800 and training_of(policy)["scenes"] == ["iid"]


def test_results_given_for_the_policy_are_shortened_to_figures_and_intervals(policy, tmp_path):
    file = write(tmp_path / "result.json", result(policy, scenes="street", success=0.912345678))
    found = evaluations_of(policy, [file])["street"]
    assert found["success"] == 0.9123 and found["success_95"] == [0.6, 0.98]
    assert "per_scene" not in found


def test_the_later_of_two_results_on_the_same_scenes_counts(policy, tmp_path):
    files = [write(tmp_path / f"{n}.json", result(policy, scenes="street", success=n / 10)) for n in (1, 2)]
    assert evaluations_of(policy, files)["street"]["success"] == 0.2


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (RESULT, "is not of these weights"),
        ([], "is not of these weights"),
        ({"success": 1.0}, "is no result of one policy"),
        ([3], "is no result of one policy"),
    ],
)
def test_a_result_of_another_policy_or_none_is_refused(policy, tmp_path, content, words):
    with pytest.raises(RunError, match=words):
        evaluations_of(policy, [write(tmp_path / "result.json", content)])


def test_a_result_of_a_variant_is_not_one_of_the_policy(policy, tmp_path):
    with pytest.raises(RunError, match="is not of these weights"):
        evaluations_of(policy, [write(tmp_path / "result.json", result(policy, variant="hybrid"))])


@pytest.mark.parametrize("content", [None, b"{", b"\xff"])
def test_a_file_that_cannot_be_read_is_named(policy, tmp_path, content):
    file = tmp_path / "result.json"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(RunError, match=r"result\.json cannot be read"):
        evaluations_of(policy, [file])
