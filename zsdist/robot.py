"""`python -m zsdist.robot SCENE.yaml`: the simulated car as a robot of ROS 2 over zenoh, in a process of its own."""

import argparse
import math
import threading
import time
from pathlib import Path
from typing import Any

from zsdist import config
from zsdist.common import cli, output_files, random_streams, signals
from zsdist.common.plain_lines import say
from zsdist.config import Config
from zsdist.errors import DecodeError, RunError
from zsdist.evaluation.episodes import Course
from zsdist.piloting import options as kinds
from zsdist.planning.grid import Grid
from zsdist.ros2 import messages
from zsdist.ros2.keys import SENSOR_DATA, QualityOfService
from zsdist.ros2.messages import NS_PER_S, CompressedPicture, OdometryReading, Velocity
from zsdist.ros2.node import NewestMessage, RosNode
from zsdist.sim.camera import make_camera
from zsdist.sim.robot import (
    BRAKES_AFTER_S,
    CameraFaults,
    LatePictures,
    OdometryErrors,
    RobotWorld,
    SimulatedOdometry,
    jpeg,
    standing,
)
from zsdist.sim.scenes import scene as scene_files
from zsdist.sim.scenes.scene import Scene
from zsdist.sim.scenes.solvability import footprints
from zsdist.types import Outcome, Pose

NODE = "zsdist_robot"
RELIABLE = QualityOfService(depth=10)
STANDSTILL = Velocity(0.0, 0.0)
PATH_STEP_M = 0.05  # the driven path is measured by points so far apart, without the trembling of a car that stands
AFTERWARDS_S = 2.0  # time, simulated and real, for which the robot goes on after the end, so that its driver sees it
COMMAND_GAP_S = 0.15  # with --lockstep, time waits while the last command is older than this
LOCKSTEP_WAIT_S = 0.5
LATE_MOST_S = 0.5  # what real time may be behind


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.robot", description=__doc__)
    add = parser.add_argument
    add("scene", type=cli.path, metavar="SCENE.yaml", help="scene file; its start is where the robot stands")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--listen", metavar="ENDPOINT", help="open a zenoh router there, such as tcp/127.0.0.1:7447")
    where.add_argument("--connect", metavar="ENDPOINT", help="connect to a zenoh router that runs")
    add("--config", type=cli.configuration, metavar="FILE", help="preset or file with another camera or grid")
    add("--domain", type=kinds.domain, default=0, metavar="N", help="domain of ROS 2 (%(default)s)")
    add("--speed", type=kinds.positive, default=1.0, metavar="X", help="times real time, at most (%(default)s)")
    lockstep = "let time wait for commands that come late, so that a busy machine changes nothing"
    add("--lockstep", action="store_true", help=lockstep)
    add(
        "--timeout-s",
        type=kinds.positive,
        default=600.0,
        metavar="S",
        help="end after so much simulated time (%(default)s)",
    )
    idle = "end as a timeout when no command has come for so long after the first, simulated (%(default)s)"
    add("--idle-s", type=kinds.positive, default=30.0, metavar="S", help=idle)
    add("--seed", type=cli.natural, default=0, help="seed of all errors (%(default)s)")
    add("--json", type=cli.path, metavar="FILE", help="write how the episode ended to FILE")
    camera = parser.add_argument_group("camera").add_argument
    camera("--camera-hz", type=kinds.positive, default=10.0, metavar="HZ", help="pictures a second (%(default)s)")
    camera("--camera-latency-ms", type=kinds.natural, default=0.0, metavar="MS", help="delay of pictures (%(default)s)")
    camera("--camera-loss", type=kinds.share, default=0.0, metavar="SHARE", help="share of pictures lost (%(default)s)")
    exposure = "change of the brightness to and fro, a share (%(default)s)"
    camera("--camera-exposure", type=kinds.share, default=0.0, metavar="SHARE", help=exposure)
    odometry = parser.add_argument_group("odometry").add_argument
    scale = "standard deviation of its distances, in percent, one for the whole drive (%(default)s)"
    odometry("--odometry-error-percent", type=kinds.natural, default=0.0, metavar="P", help=scale)
    heading = "standard deviation of its headings, which wanders within ten seconds (%(default)s)"
    odometry("--odometry-error-deg", type=kinds.natural, default=0.0, metavar="D", help=heading)
    drift = "standard deviation of the heading's drift in degrees a metre, one for the whole drive (%(default)s)"
    odometry("--odometry-drift-deg-per-m", type=kinds.natural, default=0.0, metavar="D", help=drift)
    return parser


def main(options: argparse.Namespace) -> int:
    """Be the robot until the episode ends, and return the exit status."""
    if options.json is not None:
        output_files.check_writable("--json", options.json)
    settings = config.load(options.config)
    scene = _read(options.scene, Grid.from_config(settings.grid))
    with RosNode(NODE, connect=options.connect, listen=options.listen, domain=options.domain) as node:
        robot = SimulatedRobot(settings, scene, node, options)
        pose = scene.start.pose
        say(
            f"{scene.name}: robot at ({pose.x_m:g}, {pose.y_m:g}) {math.degrees(pose.heading_rad):g} deg, goal "
            f"({scene.goal[0]:g}, {scene.goal[1]:g}), router {node.endpoint}, domain {options.domain}"
        )
        try:
            robot.run()
        except KeyboardInterrupt as interruption:
            if robot.outcome is None:
                robot.reason = f"interrupted by {signals.name_of(signals.number_of(interruption))}"
            raise
        finally:
            result = robot.result()
            robot.close()
            if options.json is not None:
                output_files.write_json("--json", options.json, result)
            say(f"{result['outcome']}: {robot.reason}; {result['steps']} steps, {result['path_m']:.2f} m")
    return 0


class SimulatedRobot:
    """Robot in a scene, between its physics and its topics.

    Args:
        settings: configuration of grid, camera and simulation.
        scene: scene.
        node: node of its topics.
        options: options of the command.

    Attributes:
        outcome: how the episode ended; None before.
        reason: why it ended.
    """

    def __init__(self, settings: Config, scene: Scene, node: RosNode, options: argparse.Namespace) -> None:
        self._settings, self._scene, self._options = settings, scene, options
        self._node = node
        self._grid = Grid.from_config(settings.grid)
        self._world = RobotWorld(self._grid, settings.sim.step_s)
        self._world.begin(scene)
        self._camera = make_camera(settings.camera)
        self._odometry = SimulatedOdometry(
            scene.start.pose,
            _odometry_errors(options),
            random_streams.robot_odometry(options.seed),
            settings.sim.step_s,
        )
        self._pictures = LatePictures(_camera_faults(options), random_streams.robot_camera(options.seed))
        self._wake = threading.Event()
        self._commands = NewestMessage(self._wake.set)
        self._clock = node.publisher("/clock", messages.CLOCK, SENSOR_DATA)
        self._poses = node.publisher("/odom", messages.ODOMETRY, RELIABLE)
        self._images = node.publisher("/camera/image/compressed", messages.COMPRESSED_IMAGE, SENSOR_DATA)
        node.subscribe("/cmd_vel", messages.TWIST, self._commands.put)
        self._began_ns = time.time_ns()  # as a robot's clock: the time of day
        self._steps = 0
        self._command, self._commanded_s = STANDSTILL, -math.inf
        self._undecodable = 0
        self._path_m, self._marked = 0.0, scene.start.pose
        self._least_m = self._world.clearance_m
        self._next_picture_s = 0.0
        self._ended_s, self._stays_s = math.inf, 0.0
        self.outcome: Outcome | None = None
        self.reason = ""

    def run(self) -> None:
        """Simulate in real time, or faster, until the episode is over."""
        began_s = time.monotonic()
        while not self.over or time.monotonic() < self._stays_s:
            self.publish()
            due_s = began_s + self.time_s / self._options.speed
            self._wait(due_s)
            began_s += max(0.0, time.monotonic() - due_s - LATE_MOST_S)  # what a busy machine lost is not made up for
            self.advance()

    def publish(self) -> None:
        """Publish the clock, the odometry, and the pictures that have arrived by now."""
        now_s, motion = self.time_s, self._world.motion
        self._clock.publish(messages.encode_clock(self._stamp_ns(now_s)))
        velocity = Velocity(motion.speed_mps, motion.turn_rate_rad_s)
        reading = OdometryReading(self._stamp_ns(now_s), self._odometry.read(motion.pose), velocity)
        self._poses.publish(messages.encode_odometry(reading))
        if now_s >= self._next_picture_s - 1e-9:
            self._next_picture_s += 1 / self._options.camera_hz
            roll_rad, pitch_rad = self._world.tilt
            people = self._world.people
            self._pictures.take(now_s, self._camera.render(self._scene, motion.pose, roll_rad, pitch_rad, people))
        for taken_s, picture in self._pictures.arrived(now_s):
            self._images.publish(messages.encode_picture(CompressedPicture(self._stamp_ns(taken_s), jpeg(picture))))

    def advance(self) -> None:
        """Simulate one step under the newest command."""
        self._obey()
        braking = self.time_s - self._commanded_s > BRAKES_AFTER_S or self.outcome is not None
        contact = self._world.step(*(STANDSTILL if braking else self._command))
        self._steps += 1
        self._measure()
        if self.outcome is None:
            self.outcome = self._judge(contact)
            if self.outcome is not None:
                self._ended_s, self._stays_s = self.time_s, time.monotonic() + AFTERWARDS_S

    @property
    def over(self) -> bool:
        """True when the episode has ended, and its driver has had the time to see it."""
        return self.time_s >= self._ended_s + AFTERWARDS_S

    @property
    def time_s(self) -> float:
        """Simulated time since the start."""
        return self._steps * self._settings.sim.step_s

    def result(self) -> dict[str, Any]:
        """Return how the episode ended, with the keys of an evaluation's `per_scene`; one cut short is a timeout."""
        outcome = self.outcome or Outcome.TIMEOUT
        course = Course(self._scene, footprints(self._grid), self._settings.sim.success_radius_m)
        shortest_m = course.length_m(self._scene.start.pose)
        return {
            "scene": self._scene.name,
            "outcome": str(outcome),
            "steps": self._steps,
            "path_m": round(self._path_m, 4),
            "shortest_m": None if shortest_m is None else round(shortest_m, 4),
            "min_clearance_m": 0.0 if outcome is Outcome.COLLISION else round(self._least_m, 4),
            "time_s": round(self.time_s, 3),
            "reason": self.reason,
            "pose": [round(value, 4) for value in self._world.pose],
        }

    def close(self) -> None:
        """Release simulation and camera."""
        self._world.close()
        self._camera.close()

    @property
    def pose(self) -> Pose:
        """True pose."""
        return self._world.pose

    @property
    def speed_mps(self) -> float:
        """True speed along its heading."""
        return self._world.motion.speed_mps

    def _stamp_ns(self, time_s: float) -> int:
        return self._began_ns + round(time_s * NS_PER_S)

    def _wait(self, due_s: float) -> None:
        """Wait until a time, and in lockstep for a command, if the last one is old."""
        while (left_s := due_s - time.monotonic()) > 0:
            time.sleep(min(left_s, 0.1))
        if not self._options.lockstep or self._commanded_s == -math.inf:
            return
        give_up_s = time.monotonic() + LOCKSTEP_WAIT_S
        self._obey()
        while self.time_s - self._commanded_s > COMMAND_GAP_S and (left_s := give_up_s - time.monotonic()) > 0:
            self._wake.wait(left_s)
            self._wake.clear()
            self._obey()

    def _obey(self) -> None:
        received = self._commands.take()
        if received is None:
            return
        try:
            self._command, self._commanded_s = messages.decode_twist(received.data), self.time_s
        except DecodeError:
            self._undecodable += 1

    def _measure(self) -> None:
        pose = self._world.pose
        moved_m = math.dist(pose[:2], self._marked[:2])
        if moved_m > PATH_STEP_M:
            self._path_m, self._marked = self._path_m + moved_m, pose
        self._least_m = min(self._least_m, self._world.clearance_m)

    def _judge(self, contact: bool) -> Outcome | None:
        if contact:
            self.reason = "the robot touched something"
            return Outcome.COLLISION
        off_m = math.dist(self._world.pose[:2], self._scene.goal)
        if off_m <= self._settings.sim.success_radius_m and standing(self._world.motion):
            self.reason = f"it stands {off_m:.2f} m from the goal"
            return Outcome.SUCCESS
        if self.time_s >= self._options.timeout_s:
            self.reason = f"{self._options.timeout_s:g} s of simulated time have passed"
            return Outcome.TIMEOUT
        if self.time_s - self._commanded_s > self._options.idle_s and self._commanded_s > -math.inf:
            self.reason = f"no command for {self._options.idle_s:g} s, {off_m:.2f} m from the goal"
            return Outcome.TIMEOUT
        return None


def _read(path: Path, grid: Grid) -> Scene:
    if not path.is_file():
        raise RunError(f"scene is {str(path)!r}; allowed is one scene file")
    return scene_files.read(path, grid)


def _odometry_errors(options: argparse.Namespace) -> OdometryErrors:
    return OdometryErrors(
        scale=options.odometry_error_percent / 100,
        heading_rad=math.radians(options.odometry_error_deg),
        drift_rad_per_m=math.radians(options.odometry_drift_deg_per_m),
    )


def _camera_faults(options: argparse.Namespace) -> CameraFaults:
    return CameraFaults(options.camera_latency_ms / 1000, options.camera_loss, options.camera_exposure)


if __name__ == "__main__":
    cli.execute(main, make_parser())
