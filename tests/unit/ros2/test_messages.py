import contextlib
import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zsdist.errors import DecodeError
from zsdist.ros2 import messages
from zsdist.ros2.messages import CompressedPicture, OdometryReading, Velocity
from zsdist.types import Pose

READING = OdometryReading(1_700_000_000_123_456_789, Pose(1.0, -2.0, 2.5), Velocity(0.4, -0.2))
EXAMPLES = [
    (messages.encode_twist(Velocity(0.4, 0.1)), messages.decode_twist),
    (messages.encode_twist(Velocity(0.4, 0.1), 5), messages.decode_twist_stamped),
    (messages.encode_odometry(READING), messages.decode_odometry),
    (messages.encode_picture(CompressedPicture(7, np.arange(50, dtype=np.uint8))), messages.decode_picture),
    (messages.encode_goal((1.0, 2.0), "odom"), messages.decode_goal),
    (messages.encode_bool(True), messages.decode_bool),
    (messages.encode_clock(5), messages.decode_clock),
]


def test_types_have_the_hashes_of_ros_2():
    hashes = {kind.name: kind.hash[7:19] for kind in (messages.TWIST, messages.ODOMETRY, messages.COMPRESSED_IMAGE)}
    assert hashes == {
        "geometry_msgs/msg/Twist": "9c45bf16fe09",
        "nav_msgs/msg/Odometry": "3cc97dc7fb75",
        "sensor_msgs/msg/CompressedImage": "156407715315",
    }


def test_a_twist_is_little_endian_cdr_of_six_numbers():
    data = messages.encode_twist(Velocity(0.5, -0.25))
    assert data == b"\x00\x01\x00\x00" + struct.pack("<6d", 0.5, 0.0, 0.0, 0.0, 0.0, -0.25)
    assert messages.decode_twist(data) == Velocity(0.5, -0.25)


def test_a_twist_in_big_endian_is_read_too():
    data = b"\x00\x00\x00\x00" + struct.pack(">6d", 0.5, 0.0, 0.0, 0.0, 0.0, -0.25)
    assert messages.decode_twist(data) == Velocity(0.5, -0.25)


@settings(max_examples=50, deadline=None)
@given(st.floats(-math.pi + 1e-9, math.pi), st.floats(-1e4, 1e4), st.integers(0, 2**31 * 10**9 - 1))
def test_odometry_is_read_back(heading, x_m, time_ns):
    reading = OdometryReading(time_ns, Pose(x_m, 3.0, heading), Velocity(0.1, 0.2), "map", "base_footprint")
    found = messages.decode_odometry(messages.encode_odometry(reading))
    assert found._replace(pose=reading.pose) == reading
    assert found.pose == pytest.approx(reading.pose, abs=1e-9)


def test_a_picture_is_read_back():
    picture = CompressedPicture(12, np.arange(256, dtype=np.uint8), "camera", "png")
    found = messages.decode_picture(messages.encode_picture(picture))
    assert (found.time_ns, found.frame, found.format) == (12, "camera", "png")
    assert np.array_equal(found.data, picture.data)


def test_goals_switches_and_clocks_are_read_back():
    assert messages.decode_goal(messages.encode_goal((1.5, -2.0), "odom")) == ((1.5, -2.0), "odom")
    assert messages.decode_bool(messages.encode_bool(True)) and not messages.decode_bool(messages.encode_bool(False))
    assert messages.decode_clock(messages.encode_clock(10**18 + 1)) == 10**18 + 1


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_what_is_not_finite_is_refused(number):
    with pytest.raises(DecodeError):
        messages.decode_twist(messages.encode_twist(Velocity(number, 0.0)))
    with pytest.raises(DecodeError):
        messages.decode_odometry(messages.encode_odometry(READING._replace(pose=Pose(number, 0.0, 0.0))))


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_any_bytes_are_decoded_or_refused_by_one_error(data):
    example, decode = data.draw(st.sampled_from(EXAMPLES))
    damaged = bytearray(example[: data.draw(st.integers(0, len(example)))])
    for _ in range(data.draw(st.integers(0, 4))):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(DecodeError):
        decode(bytes(damaged))
