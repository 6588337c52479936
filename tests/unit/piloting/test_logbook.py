import errno

import pytest

from zsdist.errors import RunError
from zsdist.piloting.logbook import Logbook
from zsdist.planning.belief import BeliefMap
from zsdist.planning.grid import Grid
from zsdist.recording import log
from zsdist.ros2 import messages
from zsdist.ros2.messages import Velocity

TOPICS = {"command": ("/cmd_vel", messages.TWIST.name), "clock": ("/clock", messages.CLOCK.name)}


def test_a_message_is_in_the_file_before_the_next_and_after_a_kill(tmp_path):
    logbook = Logbook(tmp_path / "drive.mcap", TOPICS)
    logbook.write("command", messages.encode_twist(Velocity(0.5, 0.1)))
    logbook.write("clock", messages.encode_clock(7))
    assert log.salvage(tmp_path / "drive.mcap", tmp_path / "whole.mcap") == 2  # the writer never closed its file
    first, second = log.read(tmp_path / "whole.mcap")
    assert (first.topic, first.kind, messages.decode_twist(first.content)) == (
        "/cmd_vel",
        TOPICS["command"][1],
        (0.5, 0.1),
    )
    assert messages.decode_clock(second.content) == 7


def test_a_map_lies_where_the_arena_lies(tmp_path):
    belief = BeliefMap(Grid())
    belief.clear_disc(0.0, 0.0, 1.0)
    with Logbook(tmp_path / "drive.mcap", TOPICS) as logbook:
        logbook.write_map(belief, (3.0, -1.0))
    (written,) = log.read(tmp_path / "drive.mcap")
    message = written.decoded()
    assert (message.info.origin.position.x, message.info.origin.position.y) == pytest.approx((-9.5, -13.5))
    assert message.info.resolution == pytest.approx(0.15625) and set(message.data.tolist()) == {-1, 0}


def test_a_full_disk_is_told_once_and_hinders_nothing_after(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(log.Log, "write_encoded", full)
    logbook = Logbook(tmp_path / "drive.mcap", TOPICS)
    with pytest.raises(RunError, match=r"drive\.mcap cannot be written: No space left on device"):
        logbook.write("clock", messages.encode_clock(7))
    logbook.write("clock", messages.encode_clock(8))
