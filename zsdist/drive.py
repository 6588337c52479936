"""`python -m zsdist.drive BUNDLE`: drive a robot to a goal by ROS 2 topics over zenoh; it moves only with `--arm`."""

import argparse
import contextlib
import math
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from zsdist.common import cli, output_files, signals
from zsdist.common.plain_lines import say
from zsdist.errors import RunError
from zsdist.piloting import options as kinds
from zsdist.piloting import pictures
from zsdist.piloting.limits import MotionLimits
from zsdist.piloting.logbook import Logbook
from zsdist.piloting.loop import DriveLoop, DriveSettings
from zsdist.piloting.senses import DriveClock, Senses
from zsdist.ros2 import messages
from zsdist.ros2.keys import QualityOfService
from zsdist.ros2.messages import Velocity
from zsdist.ros2.node import Endpoints, NewestMessage, RosNode, RosPublisher
from zsdist.runtime.bundle import Bundle
from zsdist.runtime.runner import BundleRunner, RunnerDecision
from zsdist.types import Pose

NODE = "zsdist_drive"
COMMANDS = QualityOfService(depth=1, reliable=True)
NOT_ARRIVED = 1  # exit status
RATE = kinds.number(5.0, 100.0, "5 to 100")
ANGLE = kinds.number(20.0, 170.0, "20 to 170")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.drive", description=__doc__)
    add = parser.add_argument
    add("bundle", type=cli.path, metavar="BUNDLE", help="folder that python -m zsdist.export has written")
    add("--connect", required=True, metavar="ENDPOINT", help="endpoint of the zenoh router, such as tcp/robot:7447")
    goal = "goal in the odometry's frame, metres (default: wait for goals on --goals, one after another)"
    add("--goal", nargs=2, type=kinds.metres, metavar=("X", "Y"), help=goal)
    add("--arm", action="store_true", help="command the robot; without it nothing is sent, and nothing moves")
    topics = parser.add_argument_group("topics of ROS 2")
    topic = topics.add_argument
    topic("--camera", type=kinds.topic, default="/camera/image/compressed", help="CompressedImage (%(default)s)")
    topic("--odometry", type=kinds.topic, default="/odom", help="Odometry (%(default)s)")
    topic("--command", type=kinds.topic, default="/cmd_vel", help="Twist (%(default)s)")
    topic("--stamped", action="store_true", help="send TwistStamped instead of Twist")
    topic("--goals", type=kinds.topic, default="/goal_pose", help="PoseStamped, new goals (%(default)s)")
    topic("--clock", type=kinds.topic, default="/clock", help="simulated time, used where it ticks (%(default)s)")
    topic("--domain", type=kinds.domain, default=0, metavar="N", help="domain of ROS 2 (%(default)s)")
    safety = parser.add_argument_group("limits and stops")
    limit = safety.add_argument
    limit("--max-speed-mps", type=kinds.positive, default=1.0, metavar="V", help="most speed (%(default)s)")
    limit("--max-turn-dps", type=kinds.positive, default=90.0, metavar="W", help="most turn rate (%(default)s)")
    limit("--max-accel-mps2", type=kinds.positive, default=1.5, metavar="A", help="most acceleration (%(default)s)")
    limit("--max-turn-accel-dps2", type=kinds.positive, default=360.0, metavar="A", help="of turns (%(default)s)")
    stop = "stop when pictures, poses or the router have been silent for so long (%(default)s)"
    limit("--stop-after-s", type=kinds.positive, default=0.5, metavar="S", help=stop)
    limit("--dead-man", type=kinds.topic, metavar="TOPIC", help="Bool that must keep saying true, or the robot stops")
    limit("--give-up-s", type=kinds.positive, default=30.0, metavar="S", help="end after such a stop (%(default)s)")
    limit("--rate-hz", type=RATE, default=10.0, metavar="HZ", help="commands a second, 5 to 100 (%(default)s)")
    more = parser.add_argument_group("camera, map and results")
    angle = "horizontal angle of the robot's camera, if its pictures are not those that the bundle expects"
    more.add_argument("--camera-fov-deg", type=ANGLE, metavar="DEG", help=angle)
    arena = "centre of the policy's map in the odometry's frame (default: chosen, see docs/robot.md)"
    more.add_argument("--arena", nargs=2, type=kinds.metres, metavar=("X", "Y"), help=arena)
    more.add_argument("--record", type=cli.path, metavar="FILE.mcap", help="record what is heard and sent")
    more.add_argument("--json", type=cli.path, metavar="FILE", help="write how the drive ended to FILE")
    return parser


def main(options: argparse.Namespace) -> int:
    """Drive, and return the exit status: 0 at the goal."""
    for option, file in (("--json", options.json), ("--record", options.record)):
        if file is not None:
            output_files.check_writable(option, file)
    if options.dead_man is not None and not options.arm:
        raise RunError("--dead-man has no effect without --arm; add --arm or remove the option")
    bundle = Bundle.load(options.bundle)
    runner = BundleRunner(bundle)
    _warm_up(runner)
    with contextlib.ExitStack() as held:
        node = held.enter_context(RosNode(NODE, connect=options.connect, domain=options.domain))
        record = None if options.record is None else held.enter_context(Logbook(options.record, _topics(options)))
        with ThreadPoolExecutor(1, thread_name_prefix="decide") as pool:
            policy = _ThreadedPolicy(runner, pool, options.camera_fov_deg, record)
            return _drive(options, node, policy, bundle, record)


def _drive(
    options: argparse.Namespace, node: RosNode, policy: "_ThreadedPolicy", bundle: Bundle, record: Logbook | None
) -> int:
    wake = threading.Event()
    clock = DriveClock(time.monotonic)
    senses = Senses(clock, options.stop_after_s, wake.set, None if record is None else record.write)
    commander = _RosCommander(node, options, senses.slots["other"], record)
    for topic, kind, slot in (
        (options.clock, messages.CLOCK, "clock"),
        (options.odometry, messages.ODOMETRY, "odometry"),
        (options.camera, messages.COMPRESSED_IMAGE, "picture"),
        (options.goals, messages.POSE_STAMPED, "goal"),
        (options.dead_man, messages.BOOL, "dead_man"),
    ):
        if topic is not None:
            node.subscribe(topic, kind, senses.slots[slot].put)
    loop = DriveLoop(_settings(options), policy, bundle.grid, senses, clock, commander, say, wake=wake)
    goal = "goals from " + options.goals if options.goal is None else f"goal ({options.goal[0]:g}, {options.goal[1]:g})"
    say(f"{bundle.manifest.name}: {goal}, {'armed' if options.arm else 'not armed: nothing is commanded'}")
    try:
        loop.run()
    except KeyboardInterrupt as interruption:
        loop.interrupted(signals.name_of(signals.number_of(interruption)))
        raise
    finally:
        loop.stop()
        policy.close()
        result = loop.result() | {"bundle": bundle.manifest.name, "weights_sha256": bundle.manifest.weights_sha256}
        result |= {"decision_ms": policy.times_ms()}
        say(f"{result['outcome']}: {result['reason'] or 'an error'}; {result['actions']} actions, {result['path_m']} m")
        if options.json is not None:
            output_files.write_json("--json", options.json, result)
    return 0 if loop.outcome == "arrived" else NOT_ARRIVED


class _RosCommander:
    """Publisher of velocities, and watch for others on its topic."""

    def __init__(
        self, node: RosNode, options: argparse.Namespace, others: NewestMessage, record: Logbook | None
    ) -> None:
        self._node, self._others, self._record, self._stamped = node, others, record, options.stamped
        self._found: Endpoints = node.publishers_of(options.command)
        node.overhear(options.command, others.put_any)
        self._publisher: RosPublisher | None = None
        if options.arm:
            kind = messages.TWIST_STAMPED if options.stamped else messages.TWIST
            self._publisher = node.publisher(options.command, kind, COMMANDS)

    @property
    def connected(self) -> bool:
        return self._node.connected

    def send(self, velocity: Velocity) -> None:
        if self._publisher is not None:
            data = messages.encode_twist(velocity, time.time_ns() if self._stamped else None)
            self._publisher.publish(data)
            if self._record is not None:
                self._record.write("command", data)

    def rivals(self) -> list[str]:
        named = [one.node for one in self._found.entities() if one.session != self._node.session_id]
        if not named and self._others.count:
            named = ["one without a token"]
        return sorted(set(named))


class _ThreadedPolicy:
    """Runner of a bundle in a thread of its own, so that decisions delay no check."""

    def __init__(
        self, runner: BundleRunner, pool: ThreadPoolExecutor, camera_deg: float | None, record: Logbook | None
    ) -> None:
        self._runner, self._pool, self._camera_deg, self._record = runner, pool, camera_deg, record
        self._centre = (0.0, 0.0)
        self._times_ms: list[float] = []

    def begin(self, pose: Pose, goal_m: tuple[float, float], centre: tuple[float, float]) -> None:
        self._centre = centre
        self._pool.submit(self._runner.begin, pose, goal_m).result()

    def set_goal(self, goal_m: tuple[float, float]) -> None:
        self._pool.submit(self._runner.set_goal, goal_m).result()

    def decide(self, picture: np.ndarray, pose: Pose) -> "Future[RunnerDecision]":
        fitted = pictures.fit(picture, self._camera_deg, self._runner.bundle.camera.field_of_view_deg)
        return self._pool.submit(self._timed, fitted, pose)

    def times_ms(self) -> dict[str, float]:
        if not self._times_ms:
            return {}
        return {f"p{q}": round(float(np.percentile(self._times_ms, q)), 3) for q in (50, 99)}

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _timed(self, picture: np.ndarray, pose: Pose) -> RunnerDecision:
        began_s = time.perf_counter()
        decision = self._runner.decide(picture, pose)
        self._times_ms.append(1000 * (time.perf_counter() - began_s))
        if self._record is not None:
            self._record.write_map(self._runner.belief, self._centre)
        return decision


def _warm_up(runner: BundleRunner) -> None:
    """Decide once on a grey picture, so that what is compiled at first use does not delay the drive."""
    camera = runner.bundle.camera
    runner.begin(Pose(0.3125, 0.3125, 0.0), (5.3125, 0.3125))
    runner.decide(np.full((camera.height_px, camera.width_px, 3), 127, np.uint8), Pose(0.3125, 0.3125, 0.0))


def _settings(options: argparse.Namespace) -> DriveSettings:
    return DriveSettings(
        goal=None if options.goal is None else (options.goal[0], options.goal[1]),
        centre=None if options.arena is None else (options.arena[0], options.arena[1]),
        armed=options.arm,
        rate_hz=options.rate_hz,
        stop_after_s=options.stop_after_s,
        dead_man=options.dead_man is not None,
        give_up_s=options.give_up_s,
        limits=MotionLimits(
            options.max_speed_mps,
            math.radians(options.max_turn_dps),
            options.max_accel_mps2,
            math.radians(options.max_turn_accel_dps2),
        ),
    )


def _topics(options: argparse.Namespace) -> dict[str, tuple[str, str]]:
    """Return topic and type of all that is recorded, by the name under which it is heard or sent."""
    command = messages.TWIST_STAMPED if options.stamped else messages.TWIST
    return {
        "clock": (options.clock, messages.CLOCK.name),
        "odometry": (options.odometry, messages.ODOMETRY.name),
        "picture": (options.camera, messages.COMPRESSED_IMAGE.name),
        "goal": (options.goals, messages.POSE_STAMPED.name),
        "dead_man": (options.dead_man or "/dead_man", messages.BOOL.name),
        "command": (options.command, command.name),
    }


if __name__ == "__main__":
    cli.execute(main, make_parser())
