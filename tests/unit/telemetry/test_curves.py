import pytest

from zsdist.telemetry.curves import MOST_ROWS, CurveHistory, braille


def row(episode, time_s=None, **figures):
    return {"episodes": episode, "time_s": float(episode if time_s is None else time_s)} | figures


def test_a_curve_rises_from_the_lower_left_to_the_upper_right():
    assert braille([(0.0, 0.0), (1.0, 1.0)], 2, 1) == ["⣠⠞"] or len(braille([(0.0, 0.0), (1.0, 1.0)], 2, 1)[0]) == 2
    lines = braille([(0.0, -1.0), (1.0, 5.0)], 20, 4)
    assert [len(line) for line in lines] == [20] * 4
    assert lines[0][-1] != "\u2800" and lines[-1][0] != "\u2800"
    assert lines[0][0] == lines[-1][-1] == "\u2800"


def test_a_level_curve_is_one_line():
    lines = braille([(0.0, 3.0), (9.0, 3.0)], 10, 3)
    assert sum(set(line) != {"\u2800"} for line in lines) == 1


@pytest.mark.parametrize("episodes", [5 * MOST_ROWS])
def test_a_long_history_is_thinned_out_and_keeps_its_ends(episodes):
    history = CurveHistory()
    for episode in range(episodes):
        history.add(row(episode, mean_return=1.0))
    points = history.points("mean_return")
    assert MOST_ROWS // 2 <= len(points) <= MOST_ROWS and points[0][0] == 0 and points[-1][0] >= episodes - 8


def test_a_resumed_run_goes_on_from_its_checkpoint():
    history = CurveHistory()
    for episode in (1, 2, 3, 2, 3):
        history.add(row(episode, mean_return=1.0))
    assert [x for x, _ in history.points("mean_return")] == [1, 2, 3]


def test_words_and_missing_figures_are_no_points():
    history = CurveHistory()
    history.add(row(1, mean_return="high"))
    history.add({"episodes": 2})
    assert history.points("mean_return") == [] and history.left_s(10) is None
