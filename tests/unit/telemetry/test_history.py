import json

from made_runs import make_run

from zsdist.telemetry import history


def write(folder, rows, last=""):
    folder.mkdir(exist_ok=True)
    text = "".join(json.dumps({"time_s": 1000.0 + n, "episodes": n, "stage": "train"}) + "\n" for n in range(rows))
    (folder / "metrics.jsonl").write_text(text + last)
    return folder


def test_a_short_run_is_shown_whole_and_a_line_that_is_being_written_is_left_out(tmp_path):
    folder = write(tmp_path / "run", 5, '{"episodes": 5, "loss": 0.5}\n{"episodes": 6, "lo')
    assert history.curves(folder) == {
        "time_s": [1000.0, 1001.0, 1002.0, 1003.0, 1004.0, None],
        "episodes": [0, 1, 2, 3, 4, 5],
        "loss": [None] * 5 + [0.5],
    }


def test_a_run_without_figures_has_no_curves(tmp_path):
    assert history.curves(tmp_path) == {}


def test_of_a_long_run_some_points_are_shown_in_order_from_its_beginning_to_its_end(tmp_path):
    shown = history.curves(write(tmp_path / "run", 40_000))["episodes"]
    assert history.POINTS / 2 <= len(shown) <= history.POINTS + 1
    assert shown == sorted(shown) and shown[0] == 0 and shown[-1] > 39_800


def test_points_stay_where_they_are_while_a_run_goes_on(tmp_path):
    before = history.curves(write(tmp_path / "run", 30_000))["episodes"]
    after = history.curves(write(tmp_path / "run", 30_200))["episodes"]
    assert set(before[:-1]) <= set(after)


def test_damaged_lines_and_values_that_are_no_numbers_are_left_out(tmp_path):
    folder = write(tmp_path / "run", 1, '[1]\nnonsense\n{"episodes": true, "loss": NaN}\n')
    assert history.curves(folder) == {"time_s": [1000.0, None], "episodes": [0, None]}


def test_settings_are_compared_without_those_in_which_any_two_runs_differ(tmp_path):
    runs = [make_run(tmp_path / "a", "seed=1", "agent.epsilon_min=0.07"), make_run(tmp_path / "b", "seed=2")]
    found = history.differences(runs)
    assert list(found) == ["agent.epsilon_min"] and found["agent.epsilon_min"][0] == "0.07"


def test_a_run_whose_configuration_cannot_be_read_is_compared_all_the_same(tmp_path):
    runs = [make_run(tmp_path / "a"), make_run(tmp_path / "b")]
    (runs[1] / "config.yaml").write_text("nonsense: [")
    assert set(map(tuple, history.differences(runs).values())) and all(
        values[1] == "?" for values in history.differences(runs).values()
    )
