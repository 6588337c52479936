import numpy as np
import pytest
from bundles import rewritten

from zsdist.errors import BundleError
from zsdist.runtime.bundle import Bundle
from zsdist.runtime.parity import check


def refusal(folder):
    with pytest.raises(BundleError) as caught:
        check(Bundle.load(folder))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_bundle_decides_as_recorded(small_bundle):
    calls = []
    result = check(Bundle.load(small_bundle), on_step=lambda *counts: calls.append(counts))
    assert result.steps == 12 and result.episodes == 1 and result.difference <= 1e-4
    assert calls == [(step, 12) for step in range(1, 13)]


def change_action(steps):
    steps["action"][5] = (steps["action"][5] + 1) % 5


def change_value(steps):
    steps["low_values"][3, 2] += 0.01


def change_mask(steps):
    steps["low_mask"][4] ^= 1


def change_picture(steps):
    steps["picture"][2] = 255 - steps["picture"][2]


def change_start(steps):
    steps["pose"][0, 0] = steps["goal"][0, 0]
    steps["pose"][0, 1] = steps["goal"][0, 1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (change_action, "fails at step 5 (episode 0): the action is"),
        (change_value, "fails at step 3 (episode 0): low_values differ by"),
        (change_mask, "fails at step 4 (episode 0): low_mask is"),
        (change_picture, "fails at step "),
        (change_start, "fails at step 0 (episode 0): there is no action, since the goal is reached"),
    ],
)
def test_the_step_that_differs_is_named(small_bundle, tmp_path, change, words):
    assert words in refusal(rewritten(small_bundle, tmp_path, change))


def drop_column(steps):
    del steps["pose"]


def empty(steps):
    for name in steps:
        steps[name] = steps[name][:0]


def shorten_column(steps):
    steps["pose"] = steps["pose"][:-1]


@pytest.mark.parametrize("change", [drop_column, empty, shorten_column])
def test_a_file_without_whole_steps_is_refused(small_bundle, tmp_path, change):
    assert "parity.safetensors" in refusal(rewritten(small_bundle, tmp_path, change))


def test_a_not_a_number_among_the_values_is_a_difference(small_bundle, tmp_path):
    def change(steps):
        steps["low_values"][0] = np.nan

    assert "low_values differ" in refusal(rewritten(small_bundle, tmp_path, change))
