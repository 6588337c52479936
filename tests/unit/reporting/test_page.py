import importlib
import re
import shlex
import shutil

import pytest
from fakes import FakeVisualAct, LatticeEnv
from made_runs import make_run
from rehearsal import rehearse, start

from zsdist.errors import RunError
from zsdist.evaluation.workers import Simulation
from zsdist.reporting import page, runs
from zsdist.sim.scenes import families, scene

FAKE = Simulation(lambda config, **_: LatticeEnv(config=config), lambda config: FakeVisualAct())


def written(places, out, simulation=FAKE):
    steps = []
    path = page.write(runs.read(places), out, steps.append, simulation)
    return path.read_text(), steps


def sections(text):
    return dict(re.findall(r"^## (.+?)\n\n(.*?)(?=^## |\Z)", text, flags=re.MULTILINE | re.DOTALL))


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """Return the page of a real, short run without physics."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    rehearse(start(folder))
    return written([folder], tmp_path_factory.mktemp("page"))


def test_a_run_gives_every_figure_that_it_can(driven):
    text, steps = driven
    for name in ("fig08-environment", "fig09-rewards", "fig10-guidance", "fig11-unseen", "fig12-paths"):
        assert f"({name}.png)" in text and f"({name}.svg)" in text
    for name in ("training-outcomes", "replay-sizes", "merges"):
        assert f"({name}.png)" in text
    assert sum(step.startswith("driving") for step in steps) == 7


def test_each_picture_of_a_page_lies_beside_it(tmp_path):
    folder = make_run(tmp_path / "run", episodes=30)
    text, _ = written([folder], tmp_path / "page")
    shown = set(re.findall(r"\(([\w-]+\.(?:png|svg))\)", text))
    assert shown == {file.name for file in (tmp_path / "page").iterdir()} - {"report.md"} and shown


def test_missing_material_is_named_and_not_filled_in(tmp_path):
    folder = make_run(tmp_path / "run")
    found = sections(written([folder], tmp_path / "page")[0])
    assert "no run without vision was given" in found["Reward during training (Fig. 9)"]
    assert "has no weights to drive with" in found["High-level guidance and path (Fig. 10)"]
    assert "no evaluation of a trained policy on ood-start-goal" in found["Unseen environments (Table 4)"]
    assert "--variant oracle-" in found["What limits the policy: oracles"]
    assert "fewer than two policies" in found["Baselines and ablations"]
    assert "no run with a merge was given" in found["The global policy's merges"]
    assert "fewer than 20 episodes" in found["The singleton case (Sec. 4.4)"]
    commands = re.findall(r"^    \S+ -m (zsdist\.\w+) (.+)$", "".join(found.values()), re.MULTILINE)
    for module, arguments in commands:  # what adds it is a command that its own parser takes
        importlib.import_module(module).make_parser().parse_args(shlex.split(arguments))
    assert {module for module, _ in commands} == {"zsdist.launch", "zsdist.evaluate"} and len(commands) >= 5


def test_missing_scenes_leave_out_only_the_figures_that_are_driven_in_them(tmp_path):
    (tmp_path / "scenes").mkdir()
    scene.write(families.draw("iid", "test", 0), tmp_path / "scenes" / "one.yaml")
    rehearse(start(tmp_path / "run", f"scenes.train=[{tmp_path / 'scenes'}]"))
    shutil.rmtree(tmp_path / "scenes")
    text, _ = written([tmp_path / "run"], tmp_path / "page")
    found = sections(text)
    assert f"{tmp_path / 'scenes'}" in found["Paths in unseen environments (Fig. 12)"]
    assert "(training-outcomes.png)" in text and "(merges.png)" in text


def test_runs_with_and_without_vision_are_distinguished(tmp_path):
    places = [
        make_run(tmp_path / "a", "run.name=full"),
        make_run(tmp_path / "b", "run.name=blind", "vision.rays=none"),
    ]
    rewards = sections(written(places, tmp_path / "page")[0])["Reward during training (Fig. 9)"]
    assert "With vision: full. Without: blind." in rewards and "Left out" not in rewards


def test_seeds_that_differ_in_a_setting_are_pointed_out(tmp_path):
    places = [make_run(tmp_path / "a"), make_run(tmp_path / "b", "seed=1", "agent.trail=0.8")]
    assert "differ in more than the seed:** agent.trail" in written(places, tmp_path / "page")[0]


def test_a_folder_that_cannot_be_written_is_refused_in_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match=r"--out .* cannot be written"):
        written([make_run(tmp_path / "run")], tmp_path / "file" / "page")
