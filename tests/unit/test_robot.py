import json
import math
from types import SimpleNamespace

import pytest
from robots import Topics

from zsdist import robot
from zsdist.common import cli
from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.ros2 import messages
from zsdist.ros2.messages import Velocity
from zsdist.sim.scenes.scene import Obstacle, Scene, Start

CONFIG = parse({"camera": {"size_px": 32}})
OPEN = Scene("open", "grass", Start(0.0, 0.0, 0.0), (3.0, 0.0), ())
WALLED = Scene("walled", "grass", Start(0.0, 0.0, 0.0), (8.0, 8.0), (Obstacle("tree", 3.0, 0.0, 1.0),))


@pytest.fixture
def robots():
    made = []

    def make(scene, *options):
        topics = Topics()
        words = robot.make_parser().parse_args(["scene.yaml", "--listen", "memory", *options])
        made.append(robot.SimulatedRobot(CONFIG, scene, topics.node(), words))
        return made[-1], topics.node().publisher("/cmd_vel", None, None), topics

    yield make
    for one in made:
        one.close()


def run(one, seconds, send=lambda: None):
    for _ in range(round(seconds / 0.05)):
        one.publish()
        send()
        one.advance()


def twist(publisher, speed_mps, turn_rad_s=0.0):
    return lambda: publisher.publish(messages.encode_twist(Velocity(speed_mps, turn_rad_s)))


def test_it_publishes_clock_odometry_and_pictures_with_one_clock(robots):
    one, _, topics = robots(OPEN)
    run(one, 1.0)
    clocks = [messages.decode_clock(data) for _, data in topics.sent["/clock"]]
    readings = [messages.decode_odometry(data) for _, data in topics.sent["/odom"]]
    pictures = [messages.decode_picture(data) for _, data in topics.sent["/camera/image/compressed"]]
    assert [reading.time_ns for reading in readings] == clocks and len(pictures) == 10
    assert clocks[-1] - clocks[0] == 950_000_000 and {picture.time_ns for picture in pictures} <= set(clocks)
    assert (readings[0].frame, readings[0].child, pictures[0].format) == ("odom", "base_link", "jpeg")


def test_it_obeys_and_brakes_by_itself_after_the_last_command(robots):
    one, publisher, _ = robots(OPEN)
    run(one, 1.0, twist(publisher, 0.8))
    assert one.speed_mps == pytest.approx(0.8, rel=0.2)
    run(one, 0.3)
    assert one.speed_mps > 0.4
    run(one, 0.5)
    assert abs(one.speed_mps) < 0.05 and one.outcome is None


def test_it_reaches_its_goal_when_it_stands_there(robots):
    one, publisher, _ = robots(OPEN)
    run(one, 2.6, twist(publisher, 1.2))
    assert one.outcome is None  # it drives still
    run(one, 1.0)
    result = one.result()
    assert (result["scene"], result["outcome"]) == ("open", "success") and result["path_m"] == pytest.approx(
        3.0, abs=0.6
    )
    assert result["shortest_m"] == pytest.approx(3.0, abs=0.7) and result["steps"] > 50
    assert json.dumps(result, allow_nan=False)
    run(one, 2.1)
    assert one.over


def test_a_contact_ends_the_episode(robots):
    one, publisher, _ = robots(WALLED)
    run(one, 3.0, twist(publisher, 1.0))
    assert (one.result()["outcome"], one.result()["min_clearance_m"]) == ("collision", 0.0)


def test_a_driver_that_falls_silent_ends_the_episode_after_a_while(robots):
    one, publisher, _ = robots(WALLED, "--idle-s", "3")
    run(one, 4.0)
    assert one.outcome is None  # it waits for its first command
    twist(publisher, 0.0)()
    run(one, 3.2)
    assert one.result()["outcome"] == "timeout" and "no command for 3 s" in one.reason


def test_what_is_no_twist_is_left_out(robots):
    one, publisher, _ = robots(OPEN)
    run(one, 0.5, lambda: publisher.publish(b"x"))
    run(one, 0.5, twist(publisher, math.nan))
    assert one.speed_mps == pytest.approx(0.0, abs=0.02)


def test_the_same_seed_gives_the_same_errors(robots):
    found = []
    for seed in ("1", "1", "2"):
        options = ("--odometry-error-percent", "2", "--odometry-error-deg", "1", "--camera-loss", "0.5", "--seed", seed)
        one, publisher, topics = robots(OPEN, *options)
        run(one, 2.0, twist(publisher, 0.5))
        last = messages.decode_odometry(topics.sent["/odom"][-1][1]).pose
        found.append((last, len(topics.sent["/camera/image/compressed"])))
    assert found[0] == found[1] != found[2]


@pytest.mark.parametrize(
    "words",
    [(), ("--listen", "tcp/h:1", "--connect", "tcp/h:1"), ("--listen", "tcp/h:1", "--speed", "0"), ("--connect",)],
)
def test_wrong_options_are_refused_in_one_line(words, capsys):
    with pytest.raises(SystemExit) as refused:
        robot.make_parser().parse_args(["scene.yaml", *words])
    assert refused.value.code == cli.REFUSED and len(capsys.readouterr().err.splitlines()) == 1


def test_a_folder_is_no_scene(tmp_path):
    options = SimpleNamespace(**vars(robot.make_parser().parse_args([str(tmp_path), "--listen", "tcp/127.0.0.1:7447"])))
    with pytest.raises(RunError, match="allowed is one scene file"):
        robot.main(options)
