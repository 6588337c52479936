"""Programs of `examples/` that take long or need packages of their own, with `--quick`: `make test-docs`."""

import importlib.util

import gymnasium
import pytest
from documented import ROOT

from zsdist.sim.scenes.scene import read_folder

pytestmark = pytest.mark.timeout(1800)


def example(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "examples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_family_of_ones_own_is_generated_driven_and_trained_in(tmp_path, capsys):
    folder, run = tmp_path / "family", tmp_path / "run"
    scenes, success = example("custom_family").main(["--quick", "--out", str(folder), "--run", str(run)])
    assert read_folder(folder) == scenes and 0 <= success <= 1
    assert list((run / "checkpoints").glob("*/manifest.json"))


def test_a_change_to_the_algorithm_trains_and_changes_what_is_learned(tmp_path, capsys):
    found = example("custom_algorithm").main(["--quick", "--out", str(tmp_path / "runs")])
    assert set(found) == {"original", "munchausen"}
    said = capsys.readouterr().out
    assert said.count(" updates in ") == 2


@pytest.mark.parametrize(("name", "words"), [("sb3_dqn", "of 1 scenes"), ("maskable_ppo", "of 1 greedy drives")])
def test_algorithms_of_stable_baselines_train_and_drive(name, words, capsys):
    pytest.importorskip("sb3_contrib", reason="pip install 'zsdist[examples]'")
    example(name).main(["--quick"])
    assert words in capsys.readouterr().out


def test_the_checker_of_stable_baselines_gives_no_warning(recwarn):
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="pip install 'zsdist[examples]'")
    env = gymnasium.make("zsdist:zsdist/CarNavigation-v0", config={"camera": {"size_px": 64}})
    checker.check_env(env.unwrapped, warn=True)
    env.close()
    assert [str(warning.message) for warning in recwarn] == []
