"""Names that are built in or a path: who decides, what is said, and what is kept."""

from pathlib import Path

import pytest

from zsdist import config, evaluate, pretrain
from zsdist.common import places, setting_trees, values
from zsdist.config import Config
from zsdist.errors import ConfigError, RunError, SceneError, WeightsError
from zsdist.evaluation.selection import select
from zsdist.pretraining import job
from zsdist.run.checkpoint import load_policy
from zsdist.run.scene_schedule import scene_source
from zsdist.sim.scenes import families, scene
from zsdist.vision.encoders import open_encoder

LEAVES = dict(values.leaves(Config))
PATHS = {key: place for key, annotation in LEAVES.items() if (place := values.find_place(annotation)) is not None}
NO_PATHS = {"run.name", "run.address", "transport.endpoint"}  # the other settings that are texts


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def strings(tree):
    if isinstance(tree, str):
        return [tree]
    parts = list(tree.values()) if isinstance(tree, dict) else tree if isinstance(tree, list | tuple) else []
    return [text for part in parts for text in strings(part)]


def kept_paths(settings):
    return [(key, text) for key, _, text in setting_trees.find_places(settings.model_dump(mode="json"), Config)]


def takes(key, text):
    try:
        config.load(None, (f"{key}={text}",))
    except ConfigError:
        return False
    return True


def test_every_setting_that_takes_any_text_is_known_as_a_path_or_as_none(here):
    taken = {key for key in LEAVES if takes(key, "there")} | {"transport.endpoint", "run.address"}
    assert taken == set(PATHS) | NO_PATHS, "a new setting that is a path needs `Place`"


@pytest.mark.parametrize("key", PATHS)
@pytest.mark.parametrize("text", ["there", "./there", "a/../there", "~/there", "."])
def test_no_path_in_a_kept_configuration_is_relative(here, key, text, monkeypatch):
    monkeypatch.setenv("HOME", str(here / "home"))
    settings = config.load(None, (f"{key}={text}",))
    (here / "config.yaml").write_text(config.dump(settings))
    for name, kept in kept_paths(settings):
        assert kept in PATHS[name].names or Path(kept).is_absolute()
    assert config.load_kept(here / "config.yaml") == settings
    assert (str(here / "home" / "there") in dict(kept_paths(settings)).values()) == text.startswith("~")


@pytest.mark.parametrize("key", PATHS)
def test_a_relative_path_that_an_earlier_version_kept_is_refused_by_name_until_it_is_said_where_it_is(here, key):
    kept = config.dump(config.load(None, (f"{key}={here / 'eyes'}",))).replace(str(here / "eyes"), "eyes")
    (here / "config.yaml").write_text(kept)
    with pytest.raises(ConfigError, match=rf"{key} 'eyes', a relative path .*--set {key}=PATH"):
        config.load_kept(here / "config.yaml")
    assert str(here / "now") in strings(config.load_kept(here / "config.yaml", (f"{key}=now",)).model_dump())


def test_nothing_relative_is_kept_of_a_pretraining(here, monkeypatch):
    made = []
    monkeypatch.setattr(pretrain, "open_encoder", lambda encoder: None)
    monkeypatch.setattr(pretrain, "check_disk", lambda job, encoder, folder: made.append(job))

    def refuse(folder, job, lock):
        raise RunError("enough")

    monkeypatch.setattr(pretrain.jobs, "create", refuse)
    with pytest.raises(RunError, match="enough"):
        pretrain.main(pretrain.make_parser().parse_args(["--cityscapes", "photos", "--encoder", "clip"]))
    kept = made[0].to_json() | {"command": "", "families": [], "stages": []}
    assert {str(here / "photos"), str(here / "clip")} <= set(strings(kept))
    assert job.Job.from_json(made[0].to_json()) == made[0]
    with pytest.raises(ConfigError, match="cityscapes is 'photos', a relative path"):
        job.Job.from_json(made[0].to_json() | {"cityscapes": "photos"})


def test_the_families_are_those_that_settings_know():
    assert tuple(families.FAMILIES) == places.FAMILIES


@pytest.mark.parametrize("key", [key for key, place in PATHS.items() if place.names])
def test_a_built_in_name_that_is_also_a_folder_is_said_with_how_to_get_the_folder(here, key):
    name, lines = PATHS[key].names[0], []
    config.load(None, (f"{key}={name}",), lines.append)
    assert lines == []
    (here / name).mkdir()
    settings = config.load(None, (f"{key}={name}",), lines.append)
    (line,) = lines
    assert key in line and f"./{name}" in line
    assert name in strings(settings.model_dump())
    config.load(None, (f"{key}=./{name}",), lines.append)
    config.load(None, (), lines.append)
    assert len(lines) == 1, "nothing is said of the folder, nor of a default"


@pytest.mark.parametrize("name", ["test", "iid"])
def test_an_evaluation_says_which_scenes_were_taken(here, name, capsys):
    (here / name).mkdir()
    scene.write(families.draw("singleton", "test", 0), here / name / "a.yaml")
    options = evaluate.make_parser().parse_args(["nowhere", "--scenes", name])
    with pytest.raises(WeightsError):
        evaluate.main(options)
    assert f"write ./{name}" in capsys.readouterr().err
    assert select(f"./{name}", Config(), None, 0)[0].name.startswith("singleton")


@pytest.mark.parametrize("name", ["pretrained", "astar"])
def test_an_evaluation_says_which_policy_was_taken(here, name):
    lines = []
    (here / name).mkdir()
    assert evaluate.find_policy(name, notify=lines.append).name == name
    assert len(lines) == 1 and f"./{name}" in lines[0]
    with pytest.raises(WeightsError, match="no checkpoint"):
        evaluate.find_policy(f"./{name}", notify=lines.append)


def test_one_scene_file_serves_as_a_folder_of_it_and_a_wrong_name_is_shown_as_given(here):
    scene.write(families.draw("singleton", "test", 0), here / "a.yaml")
    assert [chosen.name for chosen in select("a.yaml", Config(), None, 0)] == [scene_source("a.yaml")("train", 0).name]
    with pytest.raises(SceneError, match="'ood-laoyut' is no folder"):
        scene_source(config.load(None, ("scenes.train=ood-laoyut",)).scenes.train[0])
    with pytest.raises(WeightsError, match=r"vision\.encoder is 'resnet'"):
        open_encoder(config.load(None, ("vision.encoder=resnet",)).vision.encoder)
    with pytest.raises(WeightsError, match="no checkpoint"):
        load_policy(here)


def test_an_unknown_home_is_refused(here):
    with pytest.raises(ConfigError, match="'~nobody-of-that-name' is not known"):
        config.load(None, ("vision.weights=~nobody-of-that-name/eyes",))
