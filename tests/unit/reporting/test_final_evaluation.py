"""Comparison at the end of a run, with made-up results instead of drives."""

import io
import json

import numpy as np
import pytest
from fakes import RECORD
from made_runs import RESULT, make_run

from zsdist import config
from zsdist.common.console import PlainConsole
from zsdist.evaluation.report import Report
from zsdist.reporting import final_evaluation
from zsdist.run.checkpoint import make_policy
from zsdist.sim.scenes.families import SINGLETON_SCENES
from zsdist.types import Level

PARAMETERS = {level: {"w": np.zeros(1, np.float32)} for level in Level}


def settings_of(*overrides):
    return config.load(None, ("run.episodes=500", "run.final_evaluation_episodes=30", *overrides))


def lines(settings, episodes):
    policy = make_policy(settings, PARAMETERS, "here")
    return [(trial.name, trial.scenes, trial.episodes) for trial in final_evaluation.trials(policy, settings, episodes)]


def test_a_policy_trained_on_the_singleton_family_is_compared_there_and_on_unseen_scenes():
    assert lines(settings_of("scenes.train=[singleton]"), 30) == [
        ("trained", "singleton", min(30, SINGLETON_SCENES)),
        ("untrained", "singleton", min(30, SINGLETON_SCENES)),
        ("trained", "iid", 30),
        ("random", "iid", 30),
        ("potential-field", "iid", 30),
    ]


def test_a_policy_trained_on_another_family_is_compared_on_the_test_scenes():
    compared = lines(settings_of("scenes.train=[iid]"), 7)
    assert [scenes for _, scenes, _ in compared] == ["iid", "iid", "test", "test", "test"]
    assert {episodes for _, _, episodes in compared} == {7}


def test_only_learned_policies_have_weights():
    settings = settings_of()
    policy = make_policy(settings, PARAMETERS, "here")
    for trial in final_evaluation.trials(policy, settings, 5):
        learned = trial.name in ("trained", "untrained")
        assert (trial.sha256 == policy.sha256) == learned
        assert bool(trial.contender.baseline) != learned


class Comparison:
    """Return a run whose policy is evaluated by a function that makes up a result."""

    def __init__(self, folder, monkeypatch, note=None):
        self.folder, self.output, self.asked = folder, io.StringIO(), []
        (folder / "figures").mkdir(parents=True)
        monkeypatch.setattr(
            final_evaluation, "load_policy", lambda path, *_: make_policy(settings_of(), PARAMETERS, "x")
        )
        monkeypatch.setattr(final_evaluation, "check_vision", lambda policy: note)
        monkeypatch.setattr(final_evaluation, "evaluate_all", self.evaluate_all)

    def evaluate_all(self, trials, **options):
        self.asked += [options | {"episodes": trial.episodes} for trial in trials]
        return [self.report(trial) for trial in trials]

    def report(self, trial):
        about = {"policy": trial.name, "scenes": trial.scenes, "episodes": trial.episodes}
        return Report(trial.contender, RESULT | about, [RECORD] * trial.episodes, ["x"] * trial.episodes)

    def compare(self, *overrides):
        console = PlainConsole(file=self.output, width=140)
        final_evaluation.compare(self.folder, settings_of(*overrides), console)
        return self.output.getvalue()


@pytest.mark.parametrize("override", ["run.episodes=4", "run.final_evaluation_episodes=0"])
def test_a_run_that_is_too_short_or_wants_none_is_not_evaluated(tmp_path, monkeypatch, override):
    comparison = Comparison(tmp_path / "run", monkeypatch)
    assert "no evaluation" in comparison.compare(override)
    assert comparison.asked == [] and not (comparison.folder / "evaluation.json").exists()


def test_a_short_run_is_evaluated_over_fewer_scenes(tmp_path, monkeypatch):
    comparison = Comparison(tmp_path / "run", monkeypatch)
    comparison.compare("run.episodes=15", "scenes.train=[iid]")
    assert {options["episodes"] for options in comparison.asked} == {3}


def test_results_go_into_the_run_directory_and_a_table_with_the_paths_of_the_trained_policy(tmp_path, monkeypatch):
    comparison = Comparison(tmp_path / "run", monkeypatch, note="another head")
    printed = comparison.compare("run.final_evaluation_episodes=2", "seed=3")
    results = json.loads((comparison.folder / "evaluation.json").read_text())
    assert [result["policy"] for result in results] == ["trained", "untrained", "trained", "random", "potential-field"]
    assert {options["seed"] for options in comparison.asked} == {3}
    assert "another head" in printed and "potential-field" in printed and "0.90 (0.60-0.98)" in printed
    drawn = sorted(path.name for path in (comparison.folder / "figures").glob("paths-*.png"))
    assert len(drawn) == 2


@pytest.mark.parametrize(("episodes", "figures"), [(0, 0), (3, 2)])
def test_curves_are_drawn_where_an_episode_has_finished(tmp_path, episodes, figures):
    folder = make_run(tmp_path / "run", episodes=episodes, summary={"episodes": episodes})
    (folder / "figures").mkdir()
    final_evaluation.draw_training(folder)
    assert len(list((folder / "figures").glob("*.png"))) == figures
