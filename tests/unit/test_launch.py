import shlex
import signal

import pytest
from hostile import NAMES

from zsdist import config, evaluate, launch
from zsdist.common import cli, signals
from zsdist.errors import CompleteError, RunError
from zsdist.reporting import final_evaluation
from zsdist.run import directory, opening, training
from zsdist.run.program import RunSpec


def refusal(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        cli.execute(launch.main, launch.make_parser(), list(map(str, arguments)))
    assert ended.value.code == cli.REFUSED
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    assert "Traceback" not in complaint
    return complaint


def test_an_unknown_key_is_refused_with_the_nearest_known_one(capsys, tmp_path):
    complaint = refusal(capsys, "--set", "low.lerning_rate=1", "--run-dir", tmp_path / "run")
    assert "low.lerning_rate" in complaint
    assert "'low.learning_rate'" in complaint
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "telling"),
    [
        (["--actors", "0"], "run.actors is 0"),
        (["--actors", "two"], "'two'"),
        (["--episodes", "-3"], "run.episodes is -3"),
        (["--set", "low.learning_rate=.nan"], "low.learning_rate is nan"),
        (["--set", "run.actors"], "'run.actors' is not of the form"),
        (["--set", "replay.max_bytes=1000"], "replay.max_bytes are 1000"),
        (["--set", "transport=memory"], "placement 'ray'"),
        (["--set", "scenes.train=[nowhere]"], "nowhere"),
        (["--set", "vision.weights=nowhere"], "nowhere"),
        (["--set", "scenes.test=[ood-laoyut]"], "'ood-laoyut' is no folder; allowed are singleton"),
        (["--set", "scenes.train=[]"], "scenes.train is []"),
        (["--set", "scenes.test=[]"], "scenes.test is []"),
        (["--set", "camera.forward_m=.nan"], "camera.forward_m is nan"),
        (["--set", "replay.target_return=.nan"], "replay.target_return is nan"),
        (["--set", "reward.step=.inf"], "reward.step is inf"),
        (["--set", "seed=2024-13-45"], "seed is 2024-13-45: allowed is a whole number"),
        (["--config", "no/such.yaml"], "no/such.yaml"),
        (["--frobnicate"], "--frobnicate"),
    ],
)
def test_a_wrong_argument_is_one_line_that_names_it_and_nothing_is_written(capsys, tmp_path, arguments, telling):
    assert telling in refusal(capsys, *arguments, "--run-dir", tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("text", ["{", "- a\n- b\n", "low: {learning_rate: [}"])
def test_a_broken_configuration_file_is_named(capsys, tmp_path, text):
    (tmp_path / "broken.yaml").write_text(text)
    assert "broken.yaml" in refusal(capsys, "--config", tmp_path / "broken.yaml", "--run-dir", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_scene_with_nan_is_refused_by_file(capsys, tmp_path):
    lines = ("version: 1", "name: bad", "ground: sand", "goal: {x: 8, y: 8}", "obstacles: []")
    start = "start: {x: .nan, y: 0, heading_deg: 0}"
    (tmp_path / "bad.yaml").write_text("\n".join((*lines, start)))
    assert "bad.yaml" in refusal(capsys, "--set", f"scenes.train=[{tmp_path}]", "--run-dir", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_an_empty_resume_folder_is_refused_and_left_as_it_is(capsys, tmp_path):
    assert str(tmp_path) in refusal(capsys, "--resume", tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def trained(monkeypatch, tmp_path):
    """Folder of a run whose training is complete at once; `during` is called meanwhile."""

    class Trained:
        folder, during, evaluated = tmp_path, staticmethod(lambda: None), False

    def train(spec, interrupted, watch):
        made.during()
        return {"ended": "complete", "transitions": {}, "learner_updates": {}}

    made = Trained()
    spec = RunSpec(config.Config(), "run", tmp_path, {}, None)
    monkeypatch.setattr(opening, "open_new", lambda settings, folder, notify, held: spec)
    monkeypatch.setattr(training, "train", train)
    monkeypatch.setattr(final_evaluation, "draw_training", lambda folder: None)
    monkeypatch.setattr(final_evaluation, "compare", lambda *run: setattr(made, "evaluated", True))
    return made


@pytest.mark.parametrize("name", [name for name in NAMES if name.isprintable() and "/" not in name and len(name) < 200])
@pytest.mark.parametrize(("ended", "module"), [("interrupted", launch), ("complete", evaluate)])
def test_the_command_that_goes_on_is_read_back_by_the_shell_and_by_its_own_parser(
    capsys, tmp_path, monkeypatch, name, ended, module
):
    def interrupted(folder, settings, console):
        raise KeyboardInterrupt

    folder = tmp_path / name
    spec = RunSpec(config.Config(), "run", folder, {}, None)
    summary = {"ended": ended, "episodes": 3, "transitions": {}, "learner_updates": {}}
    monkeypatch.setattr(opening, "open_new", lambda settings, folder, notify, held: spec)
    monkeypatch.setattr(training, "train", lambda spec, interrupted, watch: summary)
    monkeypatch.setattr(final_evaluation, "draw_training", lambda folder: None)
    monkeypatch.setattr(final_evaluation, "compare", interrupted)
    assert launch.main(launch.make_parser().parse_args(["--plain"])) == 130
    first, *_, command = capsys.readouterr().out.splitlines()
    assert first == f"zsdist run {folder} (seed 0)"
    _, option, run_as, *words = shlex.split(command)
    assert (option, run_as) == ("-m", module.__name__)
    options = module.make_parser().parse_args(words)
    if module is launch:
        assert options.resume == folder and options.plain
    else:
        assert options.policy == [str(folder)]


def test_an_interruption_says_what_is_saved_and_how_many_episodes_are_driven_again(capsys, monkeypatch, trained):
    told = {}
    for name, about in (("all", {}), ("until the checkpoint", {"driven_again": 4})):
        summary = {"ended": "interrupted", "episodes": 20, "transitions": {}, "learner_updates": {}} | about
        monkeypatch.setattr(training, "train", lambda spec, interrupted, watch, summary=summary: summary)
        launch.main(launch.make_parser().parse_args([]))
        told[name] = capsys.readouterr().out
    assert "interrupted after 20 episodes; everything is saved" in told["all"]
    assert "interrupted after 20 episodes; everything until there is saved" in told["until the checkpoint"]
    assert "(4 begun) is driven again" in told["until the checkpoint"]


def test_ctrl_c_in_the_evaluation_reports_that_the_training_is_saved_and_how_to_evaluate_it(
    capsys, monkeypatch, trained
):
    def interrupted(folder, settings, console):
        raise KeyboardInterrupt

    monkeypatch.setattr(final_evaluation, "compare", interrupted)
    assert launch.main(launch.make_parser().parse_args([])) == 130
    printed = capsys.readouterr().out
    assert "training is complete and saved" in printed and f"python -m zsdist.evaluate {trained.folder}" in printed


def test_a_signal_in_the_last_moment_of_the_training_leaves_out_the_evaluation(capsys, trained):
    trained.during = lambda: signal.raise_signal(signal.SIGTERM)
    assert launch.main(launch.make_parser().parse_args([])) == 143
    assert "training is complete and saved" in capsys.readouterr().out and not trained.evaluated


def test_a_second_signal_in_the_training_says_how_to_resume(capsys, monkeypatch, trained):
    def stop():
        signal.raise_signal(signal.SIGTERM)
        raise KeyboardInterrupt  # as Ray passes on what the second signal raises

    trained.during = stop
    with pytest.raises(signals.Interrupted) as stopped:
        launch.main(launch.make_parser().parse_args([]))
    assert signals.status_of(stopped.value) == 143
    assert f"--resume {trained.folder}" in capsys.readouterr().out


def test_a_folder_that_holds_a_run_is_not_overwritten(capsys, tmp_path):
    folder = directory.create(tmp_path / "run", config.Config())
    before = (folder / "config.yaml").read_bytes()
    assert "--resume" in refusal(capsys, "--seed", "5", "--run-dir", folder)
    assert (folder / "config.yaml").read_bytes() == before


class OpenedError(Exception):
    """Says how a run was opened."""


@pytest.fixture
def opened(monkeypatch):
    def open_new(settings, folder, notify, held):
        raise OpenedError("new", folder, settings.run.actors)

    def open_resumed(folder, overrides, notify, held):
        if "run.episodes=2" in overrides:
            raise CompleteError("the run has finished 2 episodes")
        raise OpenedError("resumed", folder, *overrides)

    monkeypatch.setattr(opening, "open_new", open_new)
    monkeypatch.setattr(opening, "open_resumed", open_resumed)


def launched(*arguments):
    return launch.main(launch.make_parser().parse_args(["--plain", *map(str, arguments)]))


def test_one_command_begins_a_run_resumes_it_and_ends_at_once_where_it_is_complete(capsys, tmp_path, opened):
    (tmp_path / "c.yaml").write_text("run: {actors: 3}\n")
    folder = tmp_path / "run"
    command = ("--run-dir", folder, "--auto-resume", "--config", tmp_path / "c.yaml")
    with pytest.raises(OpenedError) as new:
        launched(*command)
    assert new.value.args == ("new", folder, 3)
    directory.create(folder, config.Config())
    with pytest.raises(OpenedError) as resumed:
        launched(*command, "--actors", "5")
    assert resumed.value.args == ("resumed", folder, "run.actors=5")
    assert launched(*command, "--episodes", "2") == 0
    assert "nothing is left to do: the run has finished 2 episodes" in capsys.readouterr().out


@pytest.mark.parametrize("options", [[], ["--resume", "x", "--run-dir", "y"]])
def test_a_run_that_may_be_there_is_looked_for_in_one_folder(capsys, options):
    assert "--auto-resume needs --run-dir DIR" in refusal(capsys, "--auto-resume", *options)


@pytest.mark.parametrize("option", [["--seed", "1"], ["--config", "x.yaml"], ["--run-dir", "y"]])
def test_options_that_a_resumed_run_has_already_are_refused(capsys, tmp_path, option):
    assert option[0] in refusal(capsys, "--resume", tmp_path, *option)


@pytest.mark.parametrize(
    ("address", "endpoint", "telling"),
    [("auto", "tcp/127.0.0.1:7447", "loopback"), ("ray://10.255.255.1:10001", "tcp/10.255.255.1:7447", "ray://")],
)
def test_a_cluster_that_the_roles_could_not_reach_is_refused(capsys, tmp_path, address, endpoint, telling):
    arguments = ("--address", address, "--set", f"transport.endpoint={endpoint}", "--run-dir", tmp_path / "run")
    assert telling in refusal(capsys, *arguments)
    assert not (tmp_path / "run").exists()


def test_an_impossible_folder_is_refused_in_one_line(tmp_path):
    with pytest.raises(RunError, match="File name too long"):
        directory.create(tmp_path / ("x" * 300), config.Config())


def test_a_run_to_resume_with_an_impossible_name_is_refused_in_one_line(capsys):
    assert "File name too long" in refusal(capsys, "--resume", "x" * 300)


@pytest.mark.parametrize(
    ("arguments", "telling"),
    [
        (["--resume", "runs/x"], "--resume cannot be combined with --join: the run at tcp/127.0.0.1:1 has its own"),
        (["--episodes", "3"], "--episodes cannot be combined"),
        (["--seed", "0"], "--seed cannot be combined"),
        (["--config", "x.yaml"], "--config cannot be combined"),
        (["--run-dir", "x"], "--run-dir cannot be combined"),
        (["--address", "auto"], "--address cannot be combined"),
        (["--single-process"], "--single-process cannot be combined"),
        (["--set", "low.learning_rate=1"], "--set low.learning_rate cannot be combined with --join"),
        (["--actors", "0"], "--actors is 0; allowed is 1 to 4096"),
        (["--tls", "nowhere", "--actors", "2"], "nowhere has certificates of 0 actors and --actors is 2"),
        ([], "no hub answers at tcp/127.0.0.1:1"),
    ],
)
def test_a_join_that_cannot_be_is_refused_in_one_line(capsys, arguments, telling):
    assert telling in refusal(capsys, "--join", "tcp/127.0.0.1:1", *arguments)
