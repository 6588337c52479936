"""Robot and driver in processes of their own, over zenoh."""

import json
import signal
import subprocess
import sys
from collections import Counter

import pytest
from sockets import free_endpoint

from zsdist.recording import log
from zsdist.ros2 import messages
from zsdist.ros2.node import NewestMessage, RosNode
from zsdist.sim.scenes import scene as scene_files
from zsdist.sim.scenes.scene import Scene, Start

pytestmark = [pytest.mark.integration, pytest.mark.timeout(400)]

NEAR = Scene("near", "grass", Start(-3.4375, 0.3125, 0.0), (-1.5625, 0.3125), ())
FAR = Scene("far", "grass", Start(-8.4375, 0.3125, 0.0), (8.4375, 0.3125), ())
CAMERA = "camera: {size_px: 64}\nvision: {network: student}\n"
PATIENCE_S = 300.0


@pytest.fixture
def robot(tmp_path):
    """Start a robot in a scene; return its endpoint and its process."""
    started = []

    def start(scene, *options):
        scene_files.write(scene, tmp_path / "scene.yaml")
        (tmp_path / "camera.yaml").write_text(CAMERA)
        endpoint = free_endpoint()
        words = [
            str(tmp_path / "scene.yaml"),
            "--listen",
            endpoint,
            "--config",
            str(tmp_path / "camera.yaml"),
            *options,
        ]
        process = subprocess.Popen([sys.executable, "-m", "zsdist.robot", *words], stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert endpoint in process.stdout.readline()
        return endpoint, process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def drive(bundle, endpoint, scene, *options):
    goal = [str(value) for value in scene.goal]
    words = [str(bundle), "--connect", endpoint, "--goal", *goal, *options]
    command = [sys.executable, "-m", "zsdist.drive", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_the_driver_brings_the_robot_to_its_goal_and_both_say_so(small_bundle, robot, tmp_path):
    endpoint, process = robot(NEAR, "--speed", "4", "--lockstep", "--json", str(tmp_path / "robot.json"))
    written = ("--json", str(tmp_path / "drive.json"), "--record", str(tmp_path / "drive.mcap"))
    driver = drive(small_bundle, endpoint, NEAR, "--arm", *written)
    output, complaint = driver.communicate(timeout=PATIENCE_S)
    assert (driver.returncode, complaint) == (0, ""), output + complaint
    assert process.wait(PATIENCE_S) == 0
    ended, driven = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("robot", "drive"))
    assert (ended["scene"], ended["outcome"], driven["outcome"]) == ("near", "success", "arrived")
    assert {"steps", "path_m", "shortest_m", "min_clearance_m"} <= set(ended)
    assert "arrived: the goal is reached" in output and driven["simulated_time"]
    recorded = Counter(message.topic for message in log.read(tmp_path / "drive.mcap"))
    assert recorded["/cmd_vel"] == driven["commands"] and recorded["/belief_map"] == driven["actions"] + 1
    assert set(recorded) == {"/clock", "/odom", "/camera/image/compressed", "/cmd_vel", "/belief_map"}


def test_a_signal_stops_the_robot_and_the_driver_says_why(small_bundle, robot, tmp_path):
    endpoint, _ = robot(FAR)
    heard = NewestMessage()
    with RosNode("watcher", connect=endpoint) as watcher:
        watcher.subscribe("/cmd_vel", messages.TWIST, heard.put)
        driver = drive(small_bundle, endpoint, FAR, "--arm", "--json", str(tmp_path / "drive.json"))
        while "m/s" not in driver.stdout.readline():
            pass
        driver.send_signal(signal.SIGTERM)
        output, complaint = driver.communicate(timeout=PATIENCE_S)
        assert messages.decode_twist(heard.take().data) == (0.0, 0.0)
    assert driver.returncode == 128 + signal.SIGTERM and "interrupted by SIGTERM" in complaint
    assert json.loads((tmp_path / "drive.json").read_text())["reason"] == "SIGTERM" and "stopped: SIGTERM" in output
