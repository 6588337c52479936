import re
import warnings

import pytest
from made_runs import make_run

from zsdist.reporting import curves, runs

MERGE = {"episode": 2, "candidates": ["recent", "best"], "chosen": "best", "scores": {"recent": 0.0, "best": 0.5}}


@pytest.fixture
def material(tmp_path):
    summary = {"merges": [MERGE]}
    places = [
        make_run(tmp_path / "a", "run.name=full", episodes=30, summary=summary),
        make_run(tmp_path / "b", "run.name=full", "seed=1", episodes=25),
        make_run(tmp_path / "c", "run.name=blind", episodes=30),
    ]
    return runs.read(places)


def text_of(folder, name):
    return (folder / name.replace(".png", ".svg")).read_text()


def test_rewards_name_each_method_with_its_seeds(material, tmp_path):
    drawing = text_of(tmp_path, curves.draw_rewards(material.methods, tmp_path))
    assert ">full, 2 seeds<" in drawing and ">blind<" in drawing
    assert "mean of the last 50 episodes" in drawing


def test_the_legend_of_the_first_panel_tells_single_episodes_from_their_mean(material, tmp_path):
    drawing = text_of(tmp_path, curves.draw_rewards(material.methods[1:], tmp_path))
    assert ">one episode<" in drawing and ">blind, mean<" in drawing


def test_marks_at_the_edge_of_a_figure_of_merges_are_not_clipped(material, tmp_path):
    drawing = text_of(tmp_path, curves.draw_merges(material.runs[:1], tmp_path))
    rings = re.findall(r'<path id="\w+" d="M 0 6\.5.*?</defs>\s*<g( clip-path)?', drawing, re.DOTALL)
    assert rings and not any(rings)


def test_rewards_of_a_run_without_a_merge_say_so(material, tmp_path):
    drawing = text_of(tmp_path, curves.draw_rewards(material.methods[1:], tmp_path))
    assert "no merge yet" in drawing


def test_sizes_of_a_run_too_short_for_figures_are_drawn_without_a_legend(tmp_path):
    short = runs.read([make_run(tmp_path / "short", episodes=1)]).runs
    short[0].metrics.clear()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "mean return, which sets both" in text_of(tmp_path, curves.draw_sizes(short, tmp_path))


def test_outcomes_sizes_and_merges_are_drawn(material, tmp_path):
    assert "share of the last 20" in text_of(tmp_path, curves.draw_outcomes(material.methods, tmp_path))
    assert "full, seed 1" in text_of(tmp_path, curves.draw_sizes(material.runs, tmp_path))
    merges = text_of(tmp_path, curves.draw_merges(material.runs[:1], tmp_path))
    assert all(f">{word}<" in merges for word in ("recent", "best", "promoted"))


def test_figures_are_drawn_into_a_folder_that_is_missing(material, tmp_path):
    assert curves.draw_outcomes(material.methods, tmp_path / "copied run" / "figures").endswith(".png")
    assert (tmp_path / "copied run" / "figures" / "training-outcomes.svg").is_file()
