import sys
from types import ModuleType

import numpy as np
import pytest

from zsdist.errors import RunError
from zsdist.reporting import rerun_log
from zsdist.reporting.rerun_log import CarFrame, RerunLog, require_rerun

FULL = CarFrame(
    "0 iid-1", (1.0, 2.0, 90.0), (0.0, 0.0), (5.0, 5.0), [(1.0, 2.0, 0.5)], [(3.0, 3.0, 2.0, 1.0, 30.0)],
    path=[(0.0, 0.0)], way=[(1.0, 2.0), (5.0, 5.0)], subgoal=(2.0, 2.0), picture=np.zeros((16, 16, 3), np.uint8),
    attention=np.zeros((16, 16, 3), np.uint8), rays=[(0.0, 1.0, 2.0, 3.0)], belief=np.zeros((8, 8), np.uint8),
    values={"goal": 0.5}, action="forward", shield_changed=True,
)  # fmt: skip
BARE = CarFrame("0 iid-1", (1.0, 3.0, 90.0), (0.0, 0.0), (5.0, 5.0), [], [], action="success")
EVERY = ["attention", "belief", "camera", "decision", "scene/boxes", "scene/car", "scene/goal", "scene/path",
         "scene/rays/far", "scene/rays/median", "scene/rays/near", "scene/round", "scene/start", "scene/subgoal",
         "scene/way", "shield/changed", "values/goal"]  # fmt: skip


class Made:
    """Any object of the fake SDK: knows how it was made."""

    def __init__(self, name, /, *values, **fields):
        self.name, self.values, self.fields = name, values, fields

    def compress(self, **options):
        return self


class FakeStream:
    def __init__(self, name):
        self.logged, self.times, self.calls = [], [], []

    def log(self, path, shown):
        self.logged.append((self.times[-1], path, shown))

    def set_time(self, timeline, *, sequence):
        self.times.append(sequence)

    def __getattr__(self, name):
        return lambda *values, **fields: self.calls.append((name, values))


class FakeSdk(ModuleType):
    def __init__(self):
        super().__init__("rerun")
        self.streams = []

    def RecordingStream(self, name):  # noqa: N802
        self.streams.append(FakeStream(name))
        return self.streams[-1]

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *values, **fields: Made(name, *values, **fields)


@pytest.fixture
def sdk(monkeypatch):
    fake = FakeSdk()
    monkeypatch.setitem(sys.modules, "rerun", fake)
    monkeypatch.setitem(sys.modules, "rerun.blueprint", fake)
    return fake


def test_all_parts_of_a_decision_are_on_one_timeline_and_vanish_where_they_are_missing(sdk, tmp_path):
    with RerunLog(tmp_path / "car.rrd") as log:
        log.add(FULL)
        log.add(BARE)
    (stream,) = sdk.streams
    assert sorted({path for time, path, _ in stream.logged if time == 0}) == EVERY
    cleared = {path for time, path, shown in stream.logged if time == 1 and shown.name == "Clear"}
    assert {"camera", "attention", "belief", "values/goal", "scene/rays/far", "scene/way"} <= cleared
    told = [shown.values[0] for _, path, shown in stream.logged if path == "decision"]
    assert told == ["episode 0 iid-1 begins", "forward, changed by the shield", "success"]
    assert [name for name, _ in stream.calls] == ["save", "flush", "disconnect"]


def test_a_ray_begins_at_the_car_and_ends_where_free_space_does(sdk, tmp_path):
    with RerunLog(tmp_path / "car.rrd") as log:
        log.add(FULL)
    far = next(shown for _, path, shown in sdk.streams[0].logged if path == "scene/rays/far")
    ((start, end),) = far.values[0]
    assert start[:2] == (1.0, 2.0) and np.allclose(end[:2], (1.0, 5.0))  # it looks north


def test_a_live_viewer_listens_on_this_machine_only(sdk, monkeypatch):
    started = []
    monkeypatch.setattr(rerun_log.subprocess, "Popen", lambda command, **options: started.append(command))
    with RerunLog("live"):
        pass
    (command,) = started
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert sdk.streams[0].calls[0] == ("connect_grpc", ("rerun+http://127.0.0.1:9876/proxy",))


def test_a_missing_package_is_named_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(RunError, match=r"rerun-sdk.*pip install 'zsdist\[rerun\]'"):
        require_rerun()


def test_the_real_package_writes_a_file(tmp_path):
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed (390 MB)")
    with RerunLog(tmp_path / "car.rrd") as log:
        log.add(FULL)
        log.add(BARE)
    assert (tmp_path / "car.rrd").read_bytes()[:3] == b"RRF"
