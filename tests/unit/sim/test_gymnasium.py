"""What users of Gymnasium pass to the environment, and what its tools do with it."""

import copy
import json
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
import yaml
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ClosedEnvironmentError, Error, InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import check_env

import zsdist  # noqa: F401  registers the environment
from zsdist.config import Config, parse
from zsdist.errors import ConfigError, SceneError
from zsdist.sim.env import CarNavigation
from zsdist.sim.physics.kinematic import make_env
from zsdist.sim.scenes import families, scene

ID = "zsdist/CarNavigation-v0"
SETTINGS = {"camera": {"size_px": 32}, "sim": {"max_steps": 6}, "scenes": {"train_scenes": 50}}
SCENE = families.draw("iid", "train", 3)
wrap = gymnasium.wrappers


def make(**arguments):
    return gymnasium.make(ID, **({"config": SETTINGS} | arguments))


@pytest.mark.parametrize("given", ["text", "path", "mapping", "config"])
def test_a_configuration_may_be_a_path_a_mapping_or_a_config(tmp_path, given):
    file = tmp_path / "c.yaml"
    file.write_text(yaml.safe_dump(SETTINGS))
    config = {"text": str(file), "path": file, "mapping": SETTINGS, "config": parse(SETTINGS)}[given]
    assert make(config=config).unwrapped.config == parse(SETTINGS)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (3, "config is 3; allowed are a Config, a mapping"),
        ("none.yaml", "configuration file none.yaml: No such file"),
        ({"camera": {"size": 64}}, "unknown configuration key 'camera.size'"),
    ],
)
def test_a_wrong_configuration_is_named_in_one_line(config, message):
    with pytest.raises(ConfigError, match=message) as raised:
        make(config=config)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("given", ["config", "mapping", "path", "wrapped"])
def test_the_specification_passes_through_json_and_makes_an_equal_environment(tmp_path, given):
    file = tmp_path / "c.yaml"
    file.write_text(yaml.safe_dump(SETTINGS))
    env = make(config={"config": parse(SETTINGS), "path": file}.get(given, SETTINGS), family="ood-layout")
    if given == "wrapped":
        env = wrap.RecordEpisodeStatistics(wrap.FlattenObservation(env))
    text = env.spec.to_json()
    file.unlink()
    again = gymnasium.make(EnvSpec.from_json(text))
    assert (again.unwrapped.config, again.unwrapped.family) == (parse(SETTINGS), "ood-layout")
    assert again.observation_space == env.observation_space
    assert again.spec.to_json() == text
    assert "CarNavigation" in env.spec.pprint(disable_print=True)
    json.loads(text)


def test_an_environment_without_make_has_no_specification():
    env = CarNavigation(config=SETTINGS)
    assert env.spec is None
    assert env.config == parse(SETTINGS) and CarNavigation().config == Config()


def test_the_mask_is_taken_by_the_sampling_of_actions():
    env = make()
    corner = scene.Scene("corner", "grass", scene.Start(9.6875, 9.6875, 0.0), (-8.0, 8.0), ())
    for info in (env.reset(options={"scene": corner})[1], env.step(4)[-1]):
        assert info["action_mask"].dtype == np.int8
        assert all(info["action_mask"][env.action_space.sample(info["action_mask"])] for _ in range(20))


@pytest.mark.parametrize("given", ["scene", "text", "path", "mapping"])
def test_a_reset_takes_a_scene_its_file_or_its_content(tmp_path, given):
    file = tmp_path / "my scene [1].yaml"
    scene.write(SCENE, file)
    options = {"scene": SCENE, "text": str(file), "path": file, "mapping": yaml.safe_load(file.read_text())}
    env = make()
    assert env.reset(options={"scene": options[given]})[1]["scene"] == SCENE.name
    assert env.unwrapped.world.scene == SCENE


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"scenes": SCENE}, ConfigError, "reset option 'scenes' is unknown; allowed is 'scene'"),
        ([SCENE.name], ConfigError, "allowed is a dictionary with the key 'scene'"),
        ({"scene": 3}, SceneError, "reset option 'scene' is 3; allowed are a Scene, the path"),
        ({"scene": "none.yaml"}, SceneError, "scene file none.yaml: No such file"),
        ({"scene": {"name": "x"}}, SceneError, "lacks the key 'version'"),
    ],
)
def test_wrong_options_are_named_and_end_the_episode_at_most(options, error, message):
    env = make()
    env.reset(seed=1)
    with pytest.raises(error, match=message) as raised:
        env.reset(options=options)
    assert "\n" not in str(raised.value)
    assert env.reset(seed=1)[0] in env.observation_space


def test_a_scene_that_the_world_refuses_leaves_no_episode_of_two_scenes():
    env = make().unwrapped
    env.reset(seed=1)
    start = SCENE.start
    blocked = scene.Scene("b", "grass", start, SCENE.goal, (scene.Obstacle("tree", start.x_m, start.y_m, 1.0),))
    with pytest.raises(SceneError, match="stands on the start"):
        env.reset(options={"scene": blocked})
    with pytest.raises(ResetNeeded):
        env.step(0)
    with pytest.raises(ResetNeeded):
        env.picture()


@pytest.mark.parametrize("seed", [np.int64(7), np.uint8(7), np.array(7)])
def test_an_integer_of_numpy_is_a_seed_like_pythons(seed):
    env = make()
    assert env.reset(seed=seed)[1]["scene"] == make().reset(seed=7)[1]["scene"]
    assert env.unwrapped.np_random_seed == 7
    for wrong in (-1, 1.5, "7"):
        with pytest.raises(Error, match="Seed must be"):
            env.reset(seed=wrong)


def test_seeds_choose_scenes_and_a_reset_without_one_goes_on():
    env, other = make(), make()
    chosen = [env.reset(seed=seed)[1]["scene"] for seed in range(8)]
    assert chosen == [other.reset(seed=seed)[1]["scene"] for seed in range(8)]
    assert len(set(chosen)) > 4
    assert [env.reset()[1]["scene"] for _ in range(5)] == [other.reset()[1]["scene"] for _ in range(5)]
    assert len({make().reset()[1]["scene"] for _ in range(5)}) > 1  # without a seed at all


@pytest.mark.parametrize("given", ["folder", "file", "path"])
def test_a_family_may_be_a_folder_of_scene_files_or_one_file(tmp_path, monkeypatch, given):
    for index in range(3):
        scene.write(families.draw("iid", "train", index), tmp_path / f"{index}.yaml")
    monkeypatch.chdir(tmp_path.parent)
    env = make(family={"folder": tmp_path.name, "file": f"{tmp_path.name}/1.yaml", "path": tmp_path}[given])
    chosen = [env.reset(seed=seed)[1]["scene"] for seed in range(8)]
    names = [families.draw("iid", "train", index).name for index in range(3)]
    assert set(chosen) <= ({names[1]} if given == "file" else set(names))
    monkeypatch.chdir("/")
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert [again.reset(seed=seed)[1]["scene"] for seed in range(8)] == chosen


def test_a_preset_is_a_configuration_of_the_environment():
    assert CarNavigation(config="scattered", images=False).config.run.name == "scattered"


def test_the_masks_of_actions_are_found_through_wrappers_and_equal_those_of_info():
    env = wrap.RecordEpisodeStatistics(make(images=False))
    with pytest.raises(ResetNeeded, match="call reset"):
        env.get_wrapper_attr("action_masks")()
    corner = scene.Scene("corner", "grass", scene.Start(9.6875, 9.6875, 0.0), (-8.0, 8.0), ())
    for act in (lambda: env.reset(options={"scene": corner})[1], lambda: env.step(4)[-1]):
        info = act()
        masks = env.get_wrapper_attr("action_masks")()
        assert masks.dtype == bool and masks.tolist() == info["action_mask"].astype(bool).tolist()


@pytest.mark.parametrize("action", [1, np.int64(1), np.int8(1), np.array(1)])
def test_actions_may_be_integers_of_any_kind(action):
    env, plain = make(), make()
    env.reset(seed=2), plain.reset(seed=2)
    assert env.step(action)[1] == plain.step(1)[1]


@pytest.mark.parametrize("action", [5, -1, np.int64(5), 1.0, np.array([1]), "1", None])
def test_other_actions_are_refused_in_one_line(action):
    env = make()
    env.reset(seed=2)
    with pytest.raises(InvalidAction, match="allowed are the integers 0 to 4"):
        env.step(action)


def test_the_image_of_an_observation_is_the_users_own():
    env = make(render_mode="rgb_array")
    image = env.reset(seed=1)[0]["image"]
    before = image.copy()
    image[:] = 0
    assert (env.render() == before).all()


@pytest.mark.parametrize(
    "wrapper",
    [
        lambda env: wrap.TimeLimit(env, 2),
        wrap.FlattenObservation,
        lambda env: wrap.NormalizeObservation(wrap.FlattenObservation(env)),
        wrap.RecordEpisodeStatistics,
        wrap.NormalizeReward,
        lambda env: wrap.FrameStackObservation(env, 2),
        lambda env: wrap.FilterObservation(env, ["image"]),
        wrap.AddRenderObservation,
        wrap.Autoreset,
    ],
)
def test_wrappers_keep_observations_in_their_space(wrapper):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = wrapper(make(render_mode="rgb_array"))
        assert env.reset(seed=1)[0] in env.observation_space
        for _ in range(2):
            assert env.step(3)[0] in env.observation_space
        assert env.render().shape == (32, 32, 3)
        env.close()


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vector_environments_take_seeds_scenes_and_modes(tmp_path, mode):
    file = tmp_path / "x.yaml"
    scene.write(SCENE, file)
    envs = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode, config=parse(SETTINGS), render_mode="rgb_array")
    names = envs.reset(seed=5)[1]["scene"].tolist()
    assert names == [make().reset(seed=seed)[1]["scene"] for seed in (5, 6)]
    assert envs.reset(options={"scene": str(file)})[1]["scene"].tolist() == [SCENE.name] * 2
    for _ in range(8):  # past the end of an episode
        observation, _, _, _, info = envs.step(np.array([1, 3]))
    assert observation in envs.observation_space
    assert info["action_mask"].shape == (2, 5)
    assert len(envs.render()) == 2
    envs.close()


def test_the_checker_has_nothing_to_say_with_either_camera():
    for back_end in ("caster", "pybullet"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            config = SETTINGS | {"camera": {"size_px": 32, "back_end": back_end}}
            check_env(make(config=config, render_mode="rgb_array").unwrapped)


def test_the_environment_is_found_by_module_namespace_and_version():
    assert make().spec.namespace == "zsdist"
    assert isinstance(gymnasium.make(f"zsdist:{ID}", config=SETTINGS).unwrapped, CarNavigation)
    assert len(make(render_mode="rgb_array_list").reset(seed=1)) == 2


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("exact", [False, True])
def test_a_copy_goes_on_where_the_original_was_and_shares_nothing(duplicate, exact):
    env = make_env(parse(SETTINGS), exact=exact)
    env.reset(seed=4, options={"scene": families.draw("ood-dynamic", "train", 1)})
    env.step(1)
    env.step(0)
    other = duplicate(env)
    assert type(other.world) is type(env.world)
    assert other.world.pose == env.world.pose and (other.picture() == env.picture()).all()
    other.step(3)  # moves only the copy
    third, expected = duplicate(env), []
    other.close()
    for one in (env, third):
        results = [one.step(action) for action in (0, 2, 0)]
        expected.append([(step[1], step[0]["pose"].tolist(), step[0]["image"].tobytes()) for step in results])
    assert expected[0] == expected[1]
    assert env.reset()[1]["scene"] == third.reset()[1]["scene"]


def test_copies_of_other_states_have_the_same_state():
    env = CarNavigation(config=SETTINGS)
    with pytest.raises(ResetNeeded):
        copy.deepcopy(env).step(0)
    env.close()
    with pytest.raises(ClosedEnvironmentError):
        pickle.loads(pickle.dumps(env)).reset()


@pytest.mark.parametrize("use", [lambda env: env.reset(), lambda env: env.step(0), lambda env: env.render()])
def test_a_closed_environment_says_so_and_touches_no_other(use):
    env = CarNavigation(config=SETTINGS, render_mode="rgb_array")
    env.reset(seed=1)
    env.close()
    env.close()
    other = CarNavigation(config=SETTINGS)  # may get the same number from PyBullet
    other.reset(seed=1)
    before = other.world.pose
    with pytest.raises(ClosedEnvironmentError, match="the environment is closed; make another one"):
        use(env)
    with pytest.raises(RuntimeError, match="the world is closed; make another one"):
        env.world.drive(0)
    assert other.world.pose == before
