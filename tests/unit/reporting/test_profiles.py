from pathlib import Path
from types import SimpleNamespace

import pytest

from zsdist.errors import RunError
from zsdist.reporting import profiles
from zsdist.run import profiling


def run_with(folder: Path, **roles: str):
    (folder / profiling.FOLDER).mkdir(parents=True)
    for role, content in roles.items():
        (folder / profiling.FOLDER / f"{role}.1.folded").write_text(content)
    return SimpleNamespace(folder=folder)


def test_the_section_shows_roles_and_functions(tmp_path):
    run = run_with(
        tmp_path / "run",
        actor="zsdist.vision.visual_act:read 3000000\nzsdist.sim.env:step 1000000\nwaiting 9000000\n",
        learner="zsdist.dqn.fused:update 2000000\n",
    )
    lines = profiles.section([SimpleNamespace(folder=tmp_path), run], tmp_path)
    text = "\n".join(lines)
    assert (tmp_path / "profile.png").exists()
    assert "| `zsdist.vision.visual_act:read` | 3.0 |" in text
    assert "`waiting`" not in text


def test_a_run_without_a_profile_is_left_out(tmp_path):
    assert profiles.section([SimpleNamespace(folder=tmp_path)], tmp_path)[0].startswith("Left out: ")


def test_a_damaged_profile_is_refused_in_one_line(tmp_path):
    run = run_with(tmp_path / "run", actor="zsdist.vision.visual_act:read many\n")
    with pytest.raises(RunError, match="damaged"):
        profiles.section([run], tmp_path)
