"""Options of all commands that stand for settings: what they say together, and what they may not."""

import pytest

from zsdist import certs, config, doctor, evaluate, launch, monitor, pretrain, record, report
from zsdist.common import cli, values
from zsdist.config import Config
from zsdist.errors import ConfigError, RunError

COMMANDS = {module.__name__: module for module in (certs, doctor, evaluate, launch, monitor, pretrain, record, report)}
OWN = {  # options with the name of a setting that stand for something else
    ("zsdist.evaluate", "episodes"),  # of the evaluation
    ("zsdist.evaluate", "seed"),  # selects scenes
    ("zsdist.record", "episodes"),
    ("zsdist.record", "seed"),
}
VALUES = {"encoder": ("a", "b"), "weights": ("a", "b"), "address": ("auto", "h:1")}


def options_of(module):
    """Return the names of a command's options, from an empty command line."""
    parser = module.make_parser()
    positional = ["x"] if module is certs else []
    return vars(parser.parse_args(positional))


def standing():
    for name, module in COMMANDS.items():
        for option, settings in (options_of(module).get("stands_for") or {}).items():
            yield pytest.param(module, option, settings, id=f"{name} {option}")


def said(module, *arguments):
    return cli.overrides(module.make_parser().parse_args(arguments))


def flag(option):
    return f"--{option.replace('_', '-')}"


@pytest.mark.parametrize("name", [name for name, module in COMMANDS.items() if "set" in options_of(module)])
def test_every_option_with_the_name_of_a_setting_stands_for_it(name):
    options = options_of(COMMANDS[name])
    settings = {key.rpartition(".")[2] for key, _ in values.leaves(Config)}
    named = {option for option in options if option in settings and (name, option) not in OWN}
    assert named <= set(options.get("stands_for") or {})


@pytest.mark.parametrize(("module", "option", "settings"), list(standing()))
def test_an_option_and_a_setting_that_contradict_each_other_are_refused_by_both_names(module, option, settings):
    for setting in settings:
        key, _, value = setting.partition("=")
        if value:
            arguments, other = [flag(option)], {"null": "auto", "inline": "ray", "memory": "zenoh"}[value]
        else:
            one, other = VALUES.get(option, ("1", "2"))
            arguments, value = [flag(option), one], one
        for order in ([*arguments, "--set", f"{key}={other}"], ["--set", f"{key}={other}", *arguments]):
            with pytest.raises(ConfigError, match=flag(option)) as refused:
                said(module, *order)
            assert f"--set {key}={other}" in str(refused.value) and key in str(refused.value)
        assert said(module, *arguments, "--set", f"{key}={value}")


@pytest.mark.parametrize(
    "texts",
    [
        ("run.episodes=3", "run.episodes=4"),
        ("run={episodes: 3, actors: 2}", "run.actors=1"),
        ("transport=memory", "transport.kind=zenoh"),
        ("low.hidden=[8]", "low.hidden=[9]"),
    ],
)
def test_two_values_of_one_setting_are_refused_and_one_value_twice_is_not(texts):
    first, second = texts
    with pytest.raises(ConfigError, match="different values"):
        said(launch, "--set", first, "--set", second)
    assert said(launch, "--set", first, "--set", first) == (first, first)
    assert said(launch, "--set", "run.episodes=1_0", "--episodes", "10")


def test_one_process_does_not_go_with_a_cluster():
    with pytest.raises(ConfigError, match=r"--single-process and --address auto give run\.address"):
        said(launch, "--single-process", "--address", "auto")


def test_an_option_overrides_a_configuration_file(tmp_path):
    (tmp_path / "c.yaml").write_text("run: {actors: 5}\ntransport: zenoh\n")
    settings = config.load(tmp_path / "c.yaml", said(launch, "--actors", "3", "--single-process"))
    assert (settings.run.actors, settings.transport.kind, settings.placement) == (3, "memory", "inline")


def test_paths_of_options_begin_at_the_home_folder_where_they_say_so(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    options = launch.make_parser().parse_args(["--run-dir", "~/runs/a b/"])
    assert options.run_dir == tmp_path / "runs" / "a b"
    for wrong in ("", "~nobody-of-that-name/x"):
        with pytest.raises(SystemExit):
            launch.make_parser().parse_args(["--resume", wrong])


@pytest.mark.parametrize("setting", ["run.episodes=3", "low.learning_rate=1", "seed=3", "reward.goal=1"])
def test_a_setting_without_effect_on_an_evaluation_is_refused(setting):
    with pytest.raises(RunError, match="has no effect on an evaluation"):
        evaluate.find_policy("astar", overrides=(setting,))


def test_settings_of_an_evaluated_policy_may_change_unless_its_networks_depend_on_them(tmp_path):
    policy = evaluate.find_policy("pretrained", overrides=("sim.max_steps=7", "agent.trail=0"))
    assert policy.contender.config.sim.max_steps == 7
    with pytest.raises(RunError, match="networks of a learned policy depend on it"):
        evaluate.find_policy("pretrained", overrides=("grid.cells=16",))
    assert evaluate.find_policy("astar", overrides=("grid.cells=16",)).contender.config.grid.cells == 16


def test_a_setting_that_a_variant_or_a_baseline_decides_is_refused_by_both_names():
    with pytest.raises(RunError, match=r"--set agent\.low_policy: --variant hybrid has its own"):
        evaluate.find_policy("pretrained", variant="hybrid", overrides=("agent.low_policy=field",))
    with pytest.raises(RunError, match=r"--set agent\.low_policy: baseline 'potential-field' has its own"):
        evaluate.find_policy("potential-field", overrides=("agent={low_policy: field}",))


def test_options_for_vision_are_refused_beside_runs(tmp_path):
    with pytest.raises(RunError, match="--weights is for --vision"):
        report.main(report.make_parser().parse_args([str(tmp_path), "--weights", "x"]))
