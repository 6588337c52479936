import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from zsdist.errors import DataError
from zsdist.planning.grid import Grid
from zsdist.recording import log, messages
from zsdist.ros2 import messages as ros
from zsdist.types import Pose

COUNT = 30
WRITER = """
import os, sys
from pathlib import Path
from zsdist.recording import log, messages
from zsdist.ros2 import messages as ros
written = log.Log(Path(sys.argv[1]))
number = 0
while True:
    twist = ros.encode_twist(ros.Velocity(float(number), 0.0))
    written.write_encoded("/cmd_vel", ros.TWIST.name, twist, number)
    number += 1
    os.write(1, b".")
"""


def write(path, count=COUNT):
    with log.Log(path) as written:
        written.describe("about", {"robot": "one"})
        for number in range(count):
            twist = ros.encode_twist(ros.Velocity(float(number), 0.0))
            reading = ros.OdometryReading(number, Pose(number, 0.0, 0.5), ros.Velocity(0.0, 0.0))
            written.write_encoded(messages.COMMANDS, ros.TWIST.name, twist, number)
            written.write_encoded(messages.ODOMETRY, ros.ODOMETRY.name, ros.encode_odometry(reading), number)
    return path


def speeds(path):
    return [logged.decoded().linear.x for logged in log.read(path, (messages.COMMANDS,))]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return write(tmp_path_factory.mktemp("log") / "whole.mcap").read_bytes()


def test_nothing_that_was_written_is_lost_when_the_writer_is_killed(tmp_path):
    path = tmp_path / "drive.mcap"
    process = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE)
    written = len(os.read(process.stdout.fileno(), 1))
    while written < 200:
        written += len(os.read(process.stdout.fileno(), 200 - written))
    process.send_signal(signal.SIGKILL)
    process.communicate()
    with pytest.raises(DataError, match="not a whole MCAP file"):
        speeds(path)
    assert log.salvage(path, path) >= written
    assert speeds(path)[:written] == list(range(written))


def test_a_file_that_is_cut_anywhere_gives_back_all_messages_before_the_cut(tmp_path, whole):
    path, target = tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    found_before = 0
    for at in sorted(np.random.default_rng(0).integers(0, len(whole), 60)):
        path.write_bytes(whole[:at])
        try:
            count = log.salvage(path, target)
        except DataError as error:
            assert at < 100 and "is not the beginning of an MCAP file" in str(error)
            assert list(tmp_path.iterdir()) == [path]
            continue
        found = speeds(target)
        assert found == list(range(len(found))) and count - 1 <= 2 * len(found) <= count + 1
        assert len(found) >= found_before  # what was written stays
        found_before = len(found)
    assert found_before == COUNT


def test_other_readers_read_a_file_and_a_salvaged_one(tmp_path):
    path, again = write(tmp_path / "a.mcap"), tmp_path / "b.mcap"
    log.salvage(path, again)
    for one in (path, again):
        with one.open("rb") as file:
            reader = make_reader(file)
            assert reader.get_header().profile == "ros2"
            assert len(list(reader.iter_messages())) == 2 * COUNT
            assert [found.metadata for found in reader.iter_metadata()] == [{"robot": "one"}]
        with Reader(one) as bag:
            kinds = {connection.topic: connection.msgtype for connection in bag.connections}
            numbers = [
                messages.types().deserialize_cdr(raw, connection.msgtype).linear.x
                for connection, _, raw in bag.messages()
                if connection.topic == messages.COMMANDS
            ]
        assert kinds == {messages.COMMANDS: "geometry_msgs/msg/Twist", messages.ODOMETRY: "nav_msgs/msg/Odometry"}
        assert numbers == list(range(COUNT))


def test_what_is_no_recording_is_refused_in_one_line(tmp_path):
    path = tmp_path / "x.mcap"
    for content in (b"", b"text", bytes(100)):
        path.write_bytes(content)
        with pytest.raises(DataError, match=r"x\.mcap is not the beginning of an MCAP file"):
            log.salvage(path, path)
        with pytest.raises(DataError, match=r"x\.mcap is not a whole MCAP file"):
            list(log.read(path))
        assert path.read_bytes() == content and list(tmp_path.iterdir()) == [path]


def test_a_map_has_free_occupied_and_unknown_cells_in_the_frame_of_the_arena():
    grid = Grid()
    occupied, seen = np.zeros((2, grid.fine_size, grid.fine_size), bool)
    occupied[3, 5] = seen[3, 5] = seen[4, 6] = True
    message = messages.decode(
        "nav_msgs/msg/OccupancyGrid", messages.encode(messages.occupancy_grid(grid, occupied, seen, 5))
    )
    cells = message.data.reshape(grid.fine_size, grid.fine_size)
    assert (cells[3, 5], cells[4, 6], cells[0, 0]) == (100, 0, -1)
    assert message.info.origin.position.x == -grid.arena_m / 2
    assert message.info.resolution == pytest.approx(grid.fine_m)


@pytest.mark.parametrize("form", ["png", "jpeg"])
def test_a_picture_comes_back_in_the_order_red_green_blue(form):
    picture = np.zeros((32, 32, 3), np.uint8)
    picture[:16, :, 0], picture[16:, :, 2] = 200, 90
    back = messages.decompress(messages.compress(picture, form))
    assert np.abs(back.astype(int) - picture).max() <= (0 if form == "png" else 60)
    assert np.abs(back[4, 4].astype(int) - [200, 0, 0]).max() <= 3
