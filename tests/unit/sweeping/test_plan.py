import pytest

from zsdist.errors import ConfigError
from zsdist.sweeping import plan


@pytest.fixture
def read(tmp_path):
    def read(text):
        file = tmp_path / "s.yaml"
        file.write_text(text)
        return plan.read(file)

    return read


def test_every_variant_is_trained_at_every_point_of_the_grid_with_every_seed(read):
    _, trials = read(
        "seeds: [3, 5]\nepisodes: 7\nvariants: {one: {}, two: {low.hidden: [8, 9], agent: {trail: 0}}}\n"
        "grid: {low.learning_rate: [1e-3, 0.01], low.double: [true]}\n"
    )
    assert len({trial.name for trial in trials}) == len(trials) == 8
    last = trials[-1]
    assert last.title == "two, low.learning_rate=0.01, low.double=true" and last.seed == last.settings.seed == 5
    assert last.settings.low.hidden == (8, 9) and last.settings.agent.trail == 0
    assert [trial.settings.low.learning_rate for trial in trials[:2]] == [0.001, 0.01]
    assert {trial.settings.run.episodes for trial in trials} == {7}
    assert {trial.settings.placement for trial in trials} == {"inline"}


def test_the_seeds_of_a_variant_are_one_method_for_reports(read):
    _, trials = read("grid: {agent.trail: [0, 1]}")
    assert [trial.settings.run.name for trial in trials[::2]] == ["agent.trail-0"] * 3


def test_a_file_without_variants_is_the_base_itself(read, tmp_path):
    (tmp_path / "mine.yaml").write_text("run: {episodes: 4}\n")
    _, trials = read("base: mine.yaml\nsingle_process: false")
    assert [(trial.name, trial.settings.placement) for trial in trials] == [
        (f"base-seed-{seed}", "ray") for seed in (0, 1, 2)
    ]
    assert trials[0].settings.run.episodes == 4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seeds: []", "seeds"),
        ("seeds: [a]", r"seeds is .a.*whole number"),
        ("grid: {low.learning_rat: [1]}", r"unknown configuration key 'low.learning_rat'.*'low.learning_rate'"),
        ("grid: {low.discount: [2]}", r"variant low.discount=2: low.discount is"),
        ("grid: {low.discount: 0.9}", "allowed is a list of values"),
        ("grid: {low.discount: [0.9, 0.9]}", "is there twice"),
        ("variants: {a b: {}}", "'a b'; allowed are up to 100 letters"),
        ("variants: {a: 3}", "allowed is a mapping"),
        ("low: {discount: 0.9}", "unknown key 'low'.*belongs under variants or grid"),
        ("evaluation: {scene: iid}", "unknown key 'evaluation.scene'; allowed are scenes, episodes, seed"),
        ("base: nowhere.yaml", "nowhere.yaml"),
        ("[1]", "holds no mapping"),
        ("a: [", "not valid YAML"),
    ],
)
def test_an_error_names_the_file_the_key_and_the_value(read, text, words):
    with pytest.raises(ConfigError, match=rf"sweep file .*s\.yaml.*{words}"):
        read(text)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        plan.read(tmp_path / "none.yaml")
