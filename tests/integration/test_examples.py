"""The programs in `examples/`, with small settings, and the Python in the README."""

import importlib.util
import json
import re
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from types import ModuleType

import pytest
from sockets import free_endpoint

from zsdist.evaluation.baselines import BASELINES
from zsdist.transport.zenoh import ZenohHub, ZenohTransport
from zsdist.types import Outcome
from zsdist.wire import keys

ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.integration, pytest.mark.timeout(300)]


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "examples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_shipped_policy_drives_an_episode_and_shows_each_decision(capsys):
    record = example("drive_episode").main("iid", "3")
    *decisions, last = capsys.readouterr().out.splitlines()
    assert record.scene == "iid-2000003"
    assert len(decisions) == record.steps > 0
    assert record.outcome.value in last


def test_the_python_of_the_readme_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(code.splitlines()) <= 10
    exec(compile(code, "README.md", "exec"), {})
    assert re.search("success|collision|timeout", capsys.readouterr().out)


def test_a_run_in_the_scenes_of_a_folder_leaves_a_policy(tmp_path, capsys):
    run = tmp_path / "run"
    outcomes = example("train_on_folder").main(str(ROOT / "configs" / "scenes"), str(run), "2")
    assert len(outcomes) == 2 and set(outcomes) <= {outcome.value for outcome in Outcome}
    assert list((run / "checkpoints").glob("*/manifest.json"))
    scenes = {json.loads(line)["scene"] for line in (run / "episodes.jsonl").read_text().splitlines()}
    assert scenes <= {path.stem for path in (ROOT / "configs" / "scenes").glob("*.yaml")}
    assert f"is in {run}/checkpoints" in capsys.readouterr().out


def test_a_baseline_of_ones_own_is_evaluated_beside_ours():
    before = set(BASELINES)
    try:
        rates = example("custom_baseline").main(["--quick", "--scenes", "iid"])
    finally:
        for name in set(BASELINES) - before:
            del BASELINES[name]
    assert set(rates) == {"widest-way", "random"} and all(0 <= rate <= 1 for rate in rates.values())


def test_deep_q_learning_in_one_file_learns_and_drives(capsys):
    assert 0 <= example("cleanrl_dqn").main(["--quick"]) <= 1
    assert "greedy drives after 150 steps" in capsys.readouterr().out


def test_a_plain_zenoh_client_hears_the_statistics_of_a_run():
    key, fields = keys.stats("run", "actor", "0"), {"env_steps": 12}
    with ZenohHub(free_endpoint()) as hub, ThreadPoolExecutor() as pool:
        transport = ZenohTransport(hub.endpoint)
        heard = pool.submit(example("listen_to_run").main, hub.endpoint, "2")
        while not heard.done():
            transport.publish(key, json.dumps(fields).encode(), json=True)
            wait([heard], timeout=0.05)
        transport.close()
    assert heard.result() == {key: fields}


def test_the_zenoh_client_works_without_the_package():
    source = (ROOT / "examples" / "listen_to_run.py").read_text()
    assert not re.search(r"^(from|import) zsdist", source, re.MULTILINE)
