"""Drives of a simulated robot by a driver, both on one virtual clock: the rules of a machine that can hurt."""

import pytest
from robots import Chain, Straight

from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.piloting.limits import STANDSTILL
from zsdist.piloting.loop import DriveSettings
from zsdist.planning.grid import Grid
from zsdist.ros2 import messages
from zsdist.ros2.attachment import Attachment
from zsdist.ros2.node import Received
from zsdist.sim.scenes.scene import Scene, Start
from zsdist.types import Outcome

GRID = Grid()
CONFIG = parse({"camera": {"size_px": 32}})
OPEN = Scene("open", "grass", Start(-8.4375, 0.3125, 0.0), (2.1875, 0.3125), ())
NEAR = Scene("near", "grass", Start(-8.4375, 0.3125, 0.0), (-6.5625, 0.3125), ())


@pytest.fixture
def chains():
    made = []

    def make(scene=OPEN, options=(), **settings):
        settings = DriveSettings(**{"goal": scene.goal, "armed": True} | settings)
        made.append(Chain(scene, Straight(GRID), GRID, settings, *options, config=CONFIG))
        return made[-1]

    yield make
    for chain in made:
        chain.robot.close()


def is_fast(chain):
    return chain.loop.velocity.speed_mps > 0.3


def run_until_fast(chain):
    chain.run(60, is_fast)
    assert is_fast(chain)
    return chain.topics.time_s


def first_zero_after(chain, time_s):
    return next(
        sent_s - time_s for sent_s, velocity in chain.commander.sent if sent_s > time_s and velocity == STANDSTILL
    )


def run_for(chain, seconds):
    end_s = chain.robot.time_s + seconds
    chain.run(end_s)


def speed(chain):
    _, data = chain.topics.sent["/odom"][-1]
    return messages.decode_odometry(data).velocity.speed_mps


def test_the_robot_arrives_and_the_drive_ends_with_zero(chains):
    chain = chains(NEAR)
    assert chain.run() is Outcome.SUCCESS
    result = chain.loop.result()
    assert (result["outcome"], result["reason"], result["actions"]) == ("arrived", "the goal is reached", 3)
    assert chain.commander.sent[-1][1] == STANDSTILL and chain.loop.stops == []
    assert result["path_m"] == pytest.approx(1.875, abs=0.2)
    assert chain.robot.result()["outcome"] == "success"


def test_without_arm_nothing_is_commanded_and_nothing_moves(chains):
    chain = chains(armed=False)
    chain.run(20)
    assert chain.commander.sent == [] and chain.topics.sent["/cmd_vel"] == []
    assert messages.decode_odometry(chain.topics.sent["/odom"][-1][1]).pose.x_m == pytest.approx(-8.4375, abs=0.01)
    assert chain.loop.line(0.0).split()[2] in ("looking", "moving", "deciding", "coming")


@pytest.mark.parametrize("topic", ["/camera/image/compressed", "/odom", "/clock"])
def test_a_stream_that_vanishes_stops_the_robot_in_time(chains, topic):
    chain = chains()
    vanished_s = run_until_fast(chain)
    chain.topics.lost.add(topic)
    run_for(chain, 1.0)
    assert first_zero_after(chain, vanished_s) <= 0.6
    assert sum(velocity == STANDSTILL for sent_s, velocity in chain.commander.sent if sent_s > vanished_s + 0.6) >= 3
    assert abs(speed(chain)) < 0.05
    assert len(chain.loop.stops) == 1 and any("stop:" in line for line in chain.lines)
    chain.topics.lost.clear()
    run_until_fast(chain)
    assert chain.loop.stops[0]["for_s"] > 0.3 and any("going on" in line for line in chain.lines)


def test_a_router_that_vanishes_stops_the_robot_by_its_own_brake(chains):
    chain = chains()
    vanished_s = run_until_fast(chain)
    chain.commander.connected = False
    run_for(chain, 1.0)
    assert first_zero_after(chain, vanished_s) <= 0.1 and abs(speed(chain)) < 0.05
    assert chain.loop.stops[0]["reason"] == "the router is gone"


def test_a_driver_that_dies_leaves_the_robot_to_its_brake(chains):
    chain = chains()
    run_until_fast(chain)
    for _ in range(18):  # 0.9 s without the driver
        chain.robot.publish()
        chain.robot.advance()
    chain.robot.publish()
    assert abs(speed(chain)) < 0.05


def test_another_commander_ends_the_drive(chains):
    chain = chains()
    run_until_fast(chain)
    chain.commander.others = ["/teleop"]
    chain.step()
    assert chain.loop.outcome == "stopped" and "another commander is on the topic: /teleop" in chain.loop.reason
    assert chain.commander.sent[-1][1] == STANDSTILL


def test_an_odometry_that_jumps_ends_the_drive(chains):
    chain = chains()
    run_until_fast(chain)
    time_s, data = chain.topics.sent["/odom"][-1]
    reading = messages.decode_odometry(data)
    leapt = reading._replace(time_ns=reading.time_ns + 10**8, pose=reading.pose._replace(x_m=reading.pose.x_m + 3))
    chain.senses.slots["odometry"].put(Received(messages.encode_odometry(leapt), Attachment(1, 0, bytes(16)), time_s))
    chain.loop.step()
    assert chain.loop.reason == "the odometry jumped by 3.0 m" and chain.commander.sent[-1][1] == STANDSTILL


def press(chain, held):
    publisher = chain.topics.node().publisher("/hold", messages.BOOL, None)
    publisher.publish(messages.encode_bool(held))


def test_the_dead_mans_switch_has_to_be_held(chains):
    chain = chains(dead_man=True)
    chain.run(5)
    assert all(velocity == STANDSTILL for _, velocity in chain.commander.sent)
    until = lambda held: lambda chain: press(chain, held) or is_fast(chain)  # noqa: E731
    chain.run(60, until(True))
    assert is_fast(chain)
    press(chain, False)
    chain.step()
    assert chain.loop.velocity == STANDSTILL and chain.loop.stops[0]["reason"] == "the dead man's switch is released"
    chain.run(60, until(True))
    run_for(chain, 0.7)  # nobody presses any more
    assert "the dead man's switch is silent" in chain.loop.stops[-1]["reason"]


def test_a_clock_that_jumps_stops_the_robot_and_it_goes_on(chains):
    chain = chains()
    run_until_fast(chain)
    time_s, data = chain.topics.sent["/odom"][-1]
    reading = messages.decode_odometry(data)
    ahead = messages.encode_odometry(reading._replace(time_ns=reading.time_ns + 3600 * 10**9))
    chain.senses.slots["odometry"].put(Received(ahead, Attachment(1, 0, bytes(16)), time_s))
    chain.loop.step()
    assert "jumped by +3600" in chain.loop.stops[0]["reason"]
    run_until_fast(chain)


def test_no_command_is_beyond_the_limits_and_they_are_sent_at_the_rate(chains):
    chain = chains(NEAR, ("--camera-loss", "0.1", "--odometry-error-percent", "1", "--odometry-error-deg", "1"))
    chain.run()
    limits = DriveSettings(None).limits
    for (before_s, before), (after_s, after) in zip(chain.commander.sent, chain.commander.sent[1:], strict=False):
        assert 0 <= after.speed_mps <= limits.speed_mps and abs(after.turn_rad_s) <= limits.turn_rad_s
        if after != STANDSTILL:
            assert after.speed_mps - before.speed_mps <= limits.acceleration_mps2 * (after_s - before_s) + 1e-6
        assert after_s - before_s <= 0.1 + 1e-6


def test_a_new_goal_is_taken_and_one_in_another_frame_is_not(chains):
    chain = chains(OPEN)
    run_until_fast(chain)
    publisher = chain.topics.node()
    publisher.subscribe("/goal_pose", None, chain.senses.slots["goal"].put)
    goals = publisher.publisher("/goal_pose", messages.POSE_STAMPED, None)
    goals.publish(messages.encode_goal((0.0, 0.0), "map"))
    chain.step()
    assert chain.loop.result()["goal"] == list(OPEN.goal) and any(
        "frame 'map' is left out" in line for line in chain.lines
    )
    goals.publish(messages.encode_goal((-5.9375, 0.3125), "odom"))
    chain.run(60, lambda chain: chain.loop.outcome)
    assert chain.loop.outcome == "arrived" and chain.loop.result()["pose"]["x_m"] == pytest.approx(-5.94, abs=0.6)


def test_a_goal_that_does_not_fit_is_one_line(chains):
    chain = chains(goal=(40.0, 0.0))
    with pytest.raises(RunError, match=r"goal is \(40\.00, 0\.00\) in the odometry's frame"):
        chain.run(5)


def test_a_robot_that_is_never_heard_ends_the_drive(chains):
    chain = chains(give_up_s=2.0)
    chain.topics.lost |= {"/camera/image/compressed"}
    chain.run(5)
    assert chain.loop.outcome == "stopped" and chain.loop.reason == "no pictures yet; gave up after 2 s"


def test_one_line_a_second(chains):
    chain = chains()
    chain.run(10)
    assert 8 <= len(chain.lines) <= 11 and "goal" in chain.lines[-1] and "m/s" in chain.lines[-1]


def test_a_robot_that_does_not_stamp_its_messages_is_driven_by_their_arrival(chains, monkeypatch):
    for name in ("odometry", "picture"):
        encode = getattr(messages, f"encode_{name}")
        unstamped = lambda reading, encode=encode: encode(reading._replace(time_ns=0))  # noqa: E731
        monkeypatch.setattr(messages, f"encode_{name}", unstamped)
    chain = chains(NEAR)
    assert chain.run() is Outcome.SUCCESS and chain.loop.outcome == "arrived"


def test_a_clock_that_begins_to_tick_during_a_drive_is_not_the_robots(chains):
    chain = chains()
    chain.topics.lost.add("/clock")
    run_until_fast(chain)
    chain.topics.lost.clear()
    run_for(chain, 1.0)
    assert not chain.loop.result()["simulated_time"] and chain.loop.stops == []


def test_without_a_goal_the_robot_waits_and_goes_on_after_each(chains):
    chain = chains(OPEN, goal=None)
    goals = chain.topics.node()
    goals.subscribe("/goal_pose", None, chain.senses.slots["goal"].put)
    publisher = goals.publisher("/goal_pose", messages.POSE_STAMPED, None)
    run_for(chain, 2.0)
    assert chain.commander.sent == [] and "no goal yet" in chain.lines[-1]
    for x_m in (-7.1875, -5.9375):
        publisher.publish(messages.encode_goal((x_m, 0.3125), "odom"))
        chain.run(120, lambda chain, wanted=x_m: any("goal is reached" in line for line in chain.lines[-3:]))
        chain.lines.clear()
        assert chain.loop.result()["pose"]["x_m"] == pytest.approx(x_m, abs=0.6) and not chain.loop.outcome


def test_pictures_that_are_none_are_told_once_and_end_the_drive(chains, monkeypatch):
    encode = messages.encode_picture
    broken = lambda picture: encode(picture._replace(data=picture.data[:50]))  # noqa: E731
    monkeypatch.setattr(messages, "encode_picture", broken)
    chain = chains(give_up_s=3.0)
    chain.run(10)
    told = [
        line for line in chain.lines if "picture left out: picture: 50 bytes of format 'jpeg' are no picture" in line
    ]
    assert len(told) == 1 and chain.loop.outcome == "stopped" and "gave up after 3 s" in chain.loop.reason
    assert all(velocity == STANDSTILL for _, velocity in chain.commander.sent)
