"""Network of topics in memory, and drives of a simulated robot in it, on one clock and in one thread."""

import threading
from collections import defaultdict
from concurrent.futures import Future

from zsdist import robot
from zsdist.config import Config
from zsdist.piloting.loop import DriveLoop
from zsdist.piloting.senses import DriveClock, Senses
from zsdist.ros2 import messages
from zsdist.ros2.attachment import Attachment
from zsdist.ros2.node import Received
from zsdist.types import Action

STEP_S = 0.05


class Topics:
    """All topics, in the place of zenoh; `lost` names topics whose messages vanish."""

    def __init__(self):
        self.receivers = defaultdict(list)
        self.lost = set()
        self.sent = defaultdict(list)
        self.time_s = 1000.0

    def monotonic(self):
        return self.time_s

    def node(self):
        return MemoryNode(self)


class MemoryNode:
    endpoint = "memory"
    connected = True
    session_id = "here"

    def __init__(self, topics):
        self._topics = topics

    def publisher(self, topic, kind, quality):
        return MemoryPublisher(self._topics, topic)

    def subscribe(self, topic, kind, put):
        self._topics.receivers[topic].append(put)


class MemoryPublisher:
    def __init__(self, topics, topic):
        self._topics, self._topic = topics, topic

    def publish(self, data):
        topics = self._topics
        topics.sent[self._topic].append((topics.time_s, data))
        if self._topic not in topics.lost:
            for put in topics.receivers[self._topic]:
                put(Received(data, Attachment(1, 0, bytes(16)), topics.time_s))


class MemoryCommander:
    """Commander of a drive, on a topic in memory; `others` are its rivals."""

    def __init__(self, topics):
        self.others = []
        self.connected = True
        self.sent = []
        self._topics = topics
        self._publisher = MemoryPublisher(topics, "/cmd_vel")

    def send(self, velocity):
        self.sent.append((self._topics.time_s, velocity))
        if self.connected:
            self._publisher.publish(messages.encode_twist(velocity))

    def rivals(self):
        return self.others


class AtOnce:
    """Policy of a drive from a runner, which decides at once."""

    def __init__(self, runner):
        self._runner = runner

    def begin(self, pose, goal_m, centre):
        self._runner.begin(pose, goal_m)

    def set_goal(self, goal_m):
        self._runner.set_goal(goal_m)

    def decide(self, picture, pose):
        done = Future()
        done.set_result(self._runner.decide(picture, pose))
        return done


class Straight:
    """Runner without a bundle: it drives east, cell by cell, until it is at the goal."""

    def __init__(self, grid, within_m=0.6):
        self.grid, self._within_m = grid, within_m
        self.decisions = 0

    def begin(self, pose, goal_m):
        self._goal = goal_m

    set_goal = lambda self, goal_m: setattr(self, "_goal", goal_m)  # noqa: E731

    def decide(self, picture, pose):
        from types import SimpleNamespace

        from zsdist.planning.footprint import successor

        self.decisions += 1
        east, north = self._goal[0] - pose.x_m, self._goal[1] - pose.y_m
        if (east**2 + north**2) ** 0.5 <= self._within_m:
            return SimpleNamespace(action=None, target=None, arrived=True, no_way=None)
        target = self.grid.pose(successor(self.grid.lattice_state(pose), Action.FORWARD))
        return SimpleNamespace(action=Action.FORWARD, target=target, arrived=False, no_way=None)


class Chain:
    """Robot and driver of one scene, stepped together."""

    def __init__(self, scene, runner, grid, settings, *options, config=None):
        self.topics = Topics()
        options = robot.make_parser().parse_args(["scene", "--listen", "memory", *options])
        self.robot = robot.SimulatedRobot(config or Config(), scene, self.topics.node(), options)
        self.clock = DriveClock(self.topics.monotonic)
        self.senses = Senses(self.clock, settings.stop_after_s, lambda: None)
        self.commander = MemoryCommander(self.topics)
        node = self.topics.node()
        slots = (
            ("/clock", "clock"),
            ("/odom", "odometry"),
            ("/camera/image/compressed", "picture"),
            ("/hold", "dead_man"),
        )
        for topic, slot in slots:
            node.subscribe(topic, None, self.senses.slots[slot].put)
        self.lines = []
        self.loop = DriveLoop(
            settings,
            AtOnce(runner),
            grid,
            self.senses,
            self.clock,
            self.commander,
            self.lines.append,
            wake=threading.Event(),
            monotonic=self.topics.monotonic,
            wall=self.topics.monotonic,
        )

    def step(self):
        self.robot.publish()
        if not self.loop.outcome:
            self.loop.step()
        self.robot.advance()
        self.topics.time_s += STEP_S

    def run(self, most_s=600.0, until=lambda chain: False):
        while not self.robot.over and self.robot.time_s < most_s and not until(self):
            self.step()
        return self.robot.outcome
