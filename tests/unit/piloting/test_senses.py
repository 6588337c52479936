import numpy as np
import pytest

from zsdist.errors import DecodeError
from zsdist.piloting.senses import DriveClock, HostClocks, SeenPicture, Senses
from zsdist.ros2 import messages
from zsdist.ros2.attachment import Attachment
from zsdist.ros2.messages import CompressedPicture, OdometryReading, Velocity
from zsdist.ros2.node import Received
from zsdist.sim.robot import jpeg
from zsdist.types import Pose


class Watch:
    """Clock that a test sets."""

    def __init__(self):
        self.time_s = 100.0

    def __call__(self):
        return self.time_s


@pytest.fixture
def watch():
    return Watch()


def put(senses, slot, data, arrived_s=100.0):
    senses.slots[slot].put(Received(data, Attachment(1, 0, bytes(16)), arrived_s))


def odometry(time_ns, x_m=0.0, heading_rad=0.0):
    return messages.encode_odometry(OdometryReading(time_ns, Pose(x_m, 0.0, heading_rad), Velocity(0.0, 0.0)))


def test_the_clock_is_the_machines_until_a_topic_ticks(watch):
    clock = DriveClock(watch)
    assert clock.now_s() == 100.0 and not clock.simulated
    clock.tick(5 * 10**9)
    watch.time_s += 0.4
    assert clock.now_s() == 5.0 and clock.simulated and clock.fault(0.5) is None
    watch.time_s += 0.2
    assert clock.fault(0.5) == "/clock stands still for 0.6 s"


@pytest.mark.parametrize("jump_s", [-1, 3600])
def test_a_simulated_clock_that_jumps_is_told_once(watch, jump_s):
    clock = DriveClock(watch)
    clock.tick(5 * 10**9)
    clock.tick((5 + jump_s) * 10**9)
    assert clock.fault(0.5) == f"/clock jumped by {jump_s:+.1f} s"
    assert clock.fault(0.5) is None


def test_a_stop_of_this_program_and_a_jump_of_the_time_of_day_are_noticed(watch):
    wall = Watch()
    clocks = HostClocks(watch, wall)
    for clock in (watch, wall):
        clock.time_s += 0.05
    assert clocks.fault(0.5) is None
    wall.time_s += 3600.0
    assert clocks.fault(0.5) == "the clock of this machine jumped by +3600.0 s"
    for clock in (watch, wall):
        clock.time_s += 3.0
    assert clocks.fault(0.5) == "this program stood still for 3.0 s"


def test_what_cannot_be_decoded_is_counted_and_left_out(watch):
    senses = Senses(DriveClock(watch), 0.5, lambda: None)
    for slot in ("odometry", "picture", "goal", "dead_man", "clock"):
        put(senses, slot, b"\x00\x01\x00\x00")
    assert not senses.receive()
    assert (senses.odometry, senses.picture, senses.goal, senses.undecodable) == (None, None, None, 5)


@pytest.mark.parametrize(
    ("x_m", "heading_rad", "jumped"),
    [(0.3, 0.5, None), (3.0, 0.0, "the odometry jumped by 3.0 m"), (0.0, 2.0, "heading jumped by 115 degrees")],
)
def test_a_jump_of_the_odometry_is_noticed(watch, x_m, heading_rad, jumped):
    senses = Senses(DriveClock(watch), 0.5, lambda: None)
    put(senses, "odometry", odometry(10**9))
    assert senses.receive()
    put(senses, "odometry", odometry(10**9 + 5 * 10**7, x_m, heading_rad))
    senses.receive()
    assert senses.jumped is None if jumped is None else jumped in senses.jumped


@pytest.mark.parametrize(("lag_s", "fault"), [(0.9, None), (1.2, "1.2 s before"), (-0.7, "0.7 s after")])
def test_stamps_of_different_clocks_stop_the_robot(watch, lag_s, fault):
    senses = Senses(DriveClock(watch), 0.5, lambda: None)
    put(senses, "odometry", odometry(50 * 10**9))
    taken_ns = round((50 - lag_s) * 1e9)
    put(senses, "picture", messages.encode_picture(CompressedPicture(taken_ns, np.zeros(9, np.uint8))))
    senses.receive()
    found = senses.lag_fault(0.5)
    assert found is None if fault is None else fault in found


def test_the_dead_mans_switch(watch):
    senses = Senses(DriveClock(watch), 0.5, lambda: None)
    assert "has not been heard" in senses.dead_man_fault(100.0, 0.5)
    put(senses, "dead_man", messages.encode_bool(True), 100.0)
    senses.receive()
    assert senses.dead_man_fault(100.4, 0.5) is None
    assert senses.dead_man_fault(100.6, 0.5) == "the dead man's switch is silent for 0.6 s"


def test_a_picture_is_decoded_to_red_green_blue():
    picture = np.zeros((16, 16, 3), np.uint8)
    picture[..., 0] = 200
    decoded = SeenPicture(0.0, CompressedPicture(0, jpeg(picture))).decoded()
    assert decoded.shape == (16, 16, 3) and decoded[8, 8, 0] > 180 and decoded[8, 8, 2] < 20


@pytest.mark.parametrize("data", [np.zeros(0, np.uint8), np.zeros(50, np.uint8)])
def test_what_is_no_picture_is_refused(data):
    with pytest.raises(DecodeError, match="are no picture"):
        SeenPicture(0.0, CompressedPicture(0, data)).decoded()


def test_all_that_is_used_is_recorded(watch):
    heard = []
    senses = Senses(DriveClock(watch), 0.5, lambda: None, lambda name, data: heard.append((name, data)))
    put(senses, "odometry", odometry(10**9))
    put(senses, "picture", b"damaged")
    senses.receive()
    assert heard == [("odometry", odometry(10**9))]
