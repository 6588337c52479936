import time
from collections import Counter
from types import SimpleNamespace

import pytest

from zsdist.roles.base import Role
from zsdist.run import profiling
from zsdist.run.program import RoleSpec

PATIENCE_S = 30.0


class Busy(Role):
    """Role that computes for as long as it is told."""

    def __init__(self, name):
        self.context = SimpleNamespace(name=name)
        self.finished, self._next_statistics_s = False, float("inf")

    def _end_jobs(self):
        pass

    def statistics(self):
        return {}

    def work(self, until):
        while time.monotonic() < until:
            sum(range(1000))
        return until


def test_the_time_of_a_role_is_that_of_its_steps_and_the_rest_is_waiting(tmp_path):
    with profiling.sampled(tmp_path, RoleSpec("actor", "0", 3)):
        began_s = time.monotonic()
        Busy("actor-1").step(began_s + 0.2)
        stepped_s = time.monotonic() - began_s
        profiling.threading.Event().wait(0.1)
    found = profiling.read(tmp_path)
    assert set(found) == {"actor-0", "actor-1"}
    assert set(found["actor-0"]) == {(profiling.WAITING,)}
    assert 0 < found["actor-1"].total() / 1e6 < stepped_s + 0.1
    assert all(stack[0].endswith("Busy.work") for stack in found["actor-1"])
    assert sorted(path.name for path in (tmp_path / "profile").iterdir()) == ["actor-0.3.folded", "actor-1.3.folded"]


def test_nothing_is_written_where_the_run_directory_is_on_another_machine(tmp_path):
    with profiling.sampled(tmp_path / "elsewhere", RoleSpec("actor", "0", 3)):
        pass
    assert list(tmp_path.iterdir()) == []
    assert profiling.read(tmp_path) == {}


def test_incarnations_of_a_role_add_up(tmp_path):
    folder = tmp_path / profiling.FOLDER
    folder.mkdir()
    for epoch in (1, 2):
        (folder / f"learner-low.{epoch}.folded").write_text("zsdist.dqn.fused:step;torch.x:y 5\nwaiting 1\n")
    stack = ("zsdist.dqn.fused:step", "torch.x:y")
    assert profiling.read(tmp_path) == {"learner-low": Counter({stack: 10, ("waiting",): 2})}


@pytest.mark.parametrize(
    ("stack", "part"),
    [
        (("zsdist.roles.actor:Actor.work", "zsdist.vision.visual_act:VisualAct.read", "onnxruntime.x:run"), "vision"),
        (("zsdist.roles.actor:Actor.work", "zsdist.sim.camera.caster:render"), "sim.camera"),
        (("waiting",), "waiting"),
        (("threading:wait",), "roles"),
    ],
)
def test_time_belongs_to_the_innermost_part(stack, part):
    assert profiling.part(stack) == part
