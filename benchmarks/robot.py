"""Driver and simulated robot in processes of their own, against evaluation in the same scenes; stops and limits.

`python benchmarks/robot.py [--quick] [--only PART...] [--bundle DIR] [--scenes N] [--faults N] [--steps N] [--out DIR]`
measures these parts, prints a table and one JSON line, and goes on where it was when it is called again:

    pairs    each test scene of `SPLITS` driven by `zsdist.evaluate`, and by `zsdist.drive` against `zsdist.robot`
             over a router, without errors and with those of `ERRORS`
    faults   pictures, odometry or the router vanish while the robot drives, in real time: seconds until the driver
             commands zero, and until the robot stands
    limits   steps of the pilot with poses, targets and times of any kind: how many velocities are beyond a limit

The driver's router is the robot's own for pairs, and a process that is killed for faults.
"""

import argparse
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from _common import report

SPLITS = ("iid", "ood-layout")
ERRORS = ("--camera-latency-ms=100", "--camera-loss=0.1", "--odometry-error-percent=1", "--odometry-error-deg=1")
KINDS = {"clean": (), "errors": ERRORS}
CUTS = ("pictures", "odometry", "router")
PATIENCE_S = 900.0


def main() -> None:
    """Measure the parts and print their figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("--quick", action="store_true", help="a few steps of the limits alone")
    add("--only", nargs="+", choices=("pairs", "faults", "limits"), default=("limits", "faults", "pairs"))
    add("--bundle", type=Path, help="bundle to drive (default: that of the shipped policy, exported first)")
    add("--scenes", type=int, default=40, help="scenes of each split (default: 40)")
    add("--faults", type=int, default=50, help="cuts of each kind (default: 50)")
    add("--steps", type=int, default=1_000_000, help="steps of the limits (default: a million)")
    virtual = "pairs and faults in this process, on a virtual clock and over topics in memory; ten times quicker"
    add("--virtual", action="store_true", help=virtual)
    add("--speed", type=float, default=8.0, help="times real time in pairs, at most (default: 8)")
    add("--out", type=Path, default=Path("runs/robot"), help="folder of what was measured (default: runs/robot)")
    options = parser.parse_args()
    if options.quick:
        options.only, options.steps = ("limits",), 50_000
    figures: dict[str, float] = {}
    ratios: dict[str, float] = {}
    if "limits" in options.only:
        figures |= limits(options.steps)
    if "faults" in options.only and options.virtual:
        figures |= summary([virtual_fault(cut, seed) for cut in CUTS for seed in range(options.faults)])
        options.only = [part for part in options.only if part != "faults"]
    if set(options.only) & {"pairs", "faults"}:
        options.out.mkdir(parents=True, exist_ok=True)
        bundle = options.bundle or exported(options.out / "bundle")
        if "faults" in options.only:
            figures |= faults(bundle, options.faults, options.out / "faults.jsonl")
        if "pairs" in options.only:
            figures |= pairs(bundle, options, ratios)
    report("robot", figures, ratios)


def exported(folder: Path) -> Path:
    """Return a bundle of the shipped policy, made if it is missing."""
    if not (folder / "manifest.json").exists():
        subprocess.run([sys.executable, "-m", "zsdist.export", "pretrained", "--out", str(folder)], check=True)
    return folder


def limits(steps: int) -> dict[str, float]:
    """Return how many of so many steps of pilots lead to a velocity or a change of it beyond a limit."""
    from zsdist.piloting.limits import LONGEST_STEP_S, STANDSTILL, MotionLimits
    from zsdist.piloting.pilot import Pilot
    from zsdist.types import Pose

    rng = np.random.default_rng(0)
    strange = [math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0]
    beyond, done = 0, 0
    while done < steps:
        top, turn, faster, spin = np.exp(rng.uniform(-3, 2, 4)).tolist()
        bounds = MotionLimits(top, turn, faster, spin)
        target = Pose(*rng.uniform(-10, 10, 3).tolist())
        pilot = Pilot(target, bool(rng.random() < 0.7), bounds, along_target=bool(rng.random() < 0.8))
        pose, before = Pose(*(np.array(target) + rng.normal(0, 1, 3)).tolist()), STANDSTILL
        for _ in range(200):
            step_s = float(rng.choice([0.02, 0.05, 0.1, 0.1, 0.3, 10.0, 0.0, math.nan]))
            shown = pose if rng.random() > 0.02 else Pose(*(strange[index] for index in rng.integers(0, 6, 3)))
            velocity = pilot.follow(shown, step_s)
            passed_s = min(step_s, LONGEST_STEP_S) if math.isfinite(step_s) else 0.0
            beyond += not (
                0 <= velocity.speed_mps <= top
                and abs(velocity.turn_rad_s) <= turn
                and abs(velocity.speed_mps - before.speed_mps) <= faster * passed_s + 1e-9
                and abs(velocity.turn_rad_s - before.turn_rad_s) <= spin * passed_s + 1e-9
            )
            before, done = velocity, done + 1
            heading = pose.heading_rad + velocity.turn_rad_s * 0.1 * rng.normal(1, 0.3)
            way = velocity.speed_mps * 0.1 * rng.normal(1, 0.3)
            pose = Pose(pose.x_m + way * math.cos(heading), pose.y_m + way * math.sin(heading), heading)
            if pilot.done:
                break
    return {"limits_steps": done, "limits_beyond": beyond}


def pairs(bundle: Path, options: argparse.Namespace, ratios: dict[str, float]) -> dict[str, float]:
    """Drive all scenes in each way, and return the rates of success and collision."""
    figures: dict[str, float] = {}
    for split in SPLITS:
        folder = options.out / "scenes" / split
        scenes = scene_files(split, folder, options.scenes)
        evaluated = evaluate(folder, options.out / f"evaluate-{split}.json", options.scenes)
        for kind, errors in KINDS.items():
            drive = drive_virtually if options.virtual else drive_scene
            name = f"{split}-{kind}{'-virtual' if options.virtual else ''}"
            driven = [drive(bundle, scene, errors, options, name) for scene in scenes]
            for what in ("success", "collision"):
                figures[f"{split}_{kind}_{what}"] = sum(one["outcome"] == what for one in driven) / len(driven)
            figures[f"{split}_{kind}_time_s"] = float(np.median([one["time_s"] for one in driven]))
            figures[f"{split}_{kind}_stops"] = sum(len(one["drive"].get("stops", ())) for one in driven) / len(driven)
        for what in ("success", "collision"):
            figures[f"{split}_evaluate_{what}"] = evaluated[what]
        if evaluated["success"]:
            ratios[f"{split}_success_drive_vs_evaluate"] = figures[f"{split}_clean_success"] / evaluated["success"]
    return figures


def scene_files(split: str, folder: Path, count: int) -> list[Path]:
    """Return the files of the first scenes of `zsdist.evaluate --scenes SPLIT`, made where they are missing."""
    from zsdist.config import Config
    from zsdist.evaluation.selection import select
    from zsdist.sim.scenes import scene

    folder.mkdir(parents=True, exist_ok=True)
    for one in select(split, Config(), count, 0):
        path = folder / f"{one.name}.yaml"
        if not path.exists():
            scene.write(one, path)
    return sorted(folder.glob("*.yaml"))[:count]


def evaluate(folder: Path, file: Path, count: int) -> dict[str, Any]:
    """Return the result of `zsdist.evaluate` on a folder of scenes."""
    if not file.exists() or json.loads(file.read_text())["episodes"] != count:
        words = ["pretrained", "--scenes", str(folder), "--episodes", str(count), "--json", str(file), "--workers", "1"]
        subprocess.run([sys.executable, "-m", "zsdist.evaluate", *words], check=True)
    found: dict[str, Any] = json.loads(file.read_text())
    return found


def drive_scene(
    bundle: Path, scene: Path, errors: tuple[str, ...], options: argparse.Namespace, name: str
) -> dict[str, Any]:
    """Return how the robot's episode in a scene ended, with the driver's result; driven once."""
    from zsdist.sim.scenes import scene as scenes

    results = options.out / name
    results.mkdir(exist_ok=True)
    robot_file, drive_file = results / f"{scene.stem}.robot.json", results / f"{scene.stem}.drive.json"
    if not robot_file.exists():
        endpoint, seed = free_endpoint(), str(sum(scene.stem.encode()))
        goal = [str(value) for value in scenes.read(scene).goal]
        speed = ["--speed", str(options.speed), "--lockstep", "--seed", seed, "--json", str(robot_file)]
        words = [sys.executable, "-m", "zsdist.robot", str(scene), "--listen", endpoint, *speed, *errors]
        robot = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert robot.stdout is not None
        robot.stdout.readline()  # it listens
        words = [sys.executable, "-m", "zsdist.drive", str(bundle), "--connect", endpoint, "--goal", *goal, "--arm"]
        subprocess.run([*words, "--json", str(drive_file)], stdout=subprocess.DEVNULL, timeout=PATIENCE_S, check=False)
        try:
            robot.wait(60)
        except subprocess.TimeoutExpired:
            robot.kill()
    driven = json.loads(drive_file.read_text()) if drive_file.exists() else {}
    if not robot_file.exists():
        return {"outcome": "timeout", "time_s": math.nan, "drive": driven}
    found: dict[str, Any] = json.loads(robot_file.read_text()) | {"drive": driven}
    print(f"{name} {scene.stem}: {found['outcome']}, {found['time_s']:.0f} s, {driven.get('reason')}", flush=True)
    return found


def drive_virtually(
    bundle: Path, scene: Path, errors: tuple[str, ...], options: argparse.Namespace, name: str
) -> dict[str, Any]:
    """Return what `drive_scene` returns, of the same robot and driver in one thread, stepped together."""
    sys.path.append(str(Path(__file__).parents[1] / "tests"))
    from robots import Chain

    from zsdist.piloting.loop import DriveSettings
    from zsdist.runtime.bundle import Bundle
    from zsdist.runtime.runner import BundleRunner
    from zsdist.sim.scenes import scene as scenes

    results = options.out / name
    results.mkdir(exist_ok=True)
    file = results / f"{scene.stem}.json"
    if not file.exists():
        loaded, read = Bundle.load(bundle), scenes.read(scene)
        settings = DriveSettings(goal=read.goal, armed=True)
        words = ["--seed", str(sum(scene.stem.encode())), *errors]
        chain = Chain(read, BundleRunner(loaded), loaded.grid, settings, *words)
        chain.run()
        file.write_text(json.dumps(chain.robot.result() | {"drive": chain.loop.result()}))
        chain.robot.close()
    found: dict[str, Any] = json.loads(file.read_text())
    print(f"{name} {scene.stem}: {found['outcome']}, {found['time_s']:.0f} s, {found['drive']['reason']}", flush=True)
    return found


def free_endpoint() -> str:
    """Return an endpoint on a port that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class GatedNode:
    """Node of a robot whose messages can be held back by topic."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self.closed: set[str] = set()
        self.endpoint = node.endpoint

    def publisher(self, topic: str, kind: Any, quality: Any) -> Any:
        """Return a publisher that is silent while its topic is closed."""
        made, closed = self._node.publisher(topic, kind, quality), self.closed

        class Gated:
            def publish(self, data: bytes) -> None:
                if topic not in closed:
                    made.publish(data)

        return Gated()

    def subscribe(self, topic: str, kind: Any, put: Any) -> None:
        """Subscribe to a topic."""
        self._node.subscribe(topic, kind, put)


ROUTER = """
import sys, threading
from zsdist.ros2.node import RosNode
node = RosNode("router", listen=sys.argv[1])
print(node.endpoint, flush=True)
threading.Event().wait()
"""


class FaultyDrive:
    """Robot in this process, driver and router in others; goals to and fro along an open lane."""

    def __init__(self, bundle: Path) -> None:
        from zsdist import robot
        from zsdist.config import Config
        from zsdist.ros2 import messages
        from zsdist.ros2.keys import QualityOfService
        from zsdist.ros2.node import RosNode
        from zsdist.sim.scenes.scene import Scene, Start

        self._messages = messages
        self._endpoint = free_endpoint()
        self._router = self._open_router()
        self._node = RosNode("faulty_robot", connect=self._endpoint)
        self.gate = GatedNode(self._node)
        scene = Scene("lane", "asphalt", Start(-7.8125, 0.3125, 0.0), (9.0625, 9.0625), ())
        words = ["scene", "--connect", self._endpoint, "--idle-s", "100000", "--timeout-s", "100000"]
        self._robot = robot.SimulatedRobot(Config(), scene, self.gate, robot.make_parser().parse_args(words))  # type: ignore[arg-type]
        self._goals = self._node.publisher("/goal_pose", messages.POSE_STAMPED, QualityOfService())
        self._east = True
        self.zeros: list[float] = []
        self.stands_s = math.nan
        self.speed_mps = 0.0
        self._node.subscribe("/cmd_vel", messages.TWIST, self._heard)
        command = [sys.executable, "-m", "zsdist.drive", str(bundle), "--connect", self._endpoint, "--arm"]
        self._driver = subprocess.Popen([*command, "--give-up-s", "120"], stdout=subprocess.PIPE, text=True)
        self.stops: list[tuple[float, str]] = []
        threading.Thread(target=self._read, daemon=True).start()

    def step(self) -> float:
        """Simulate one step in real time; return the time."""
        self._robot.publish()
        time.sleep(max(0.0, 0.05 - (time.monotonic() % 0.05)))
        self._robot.advance()
        now_s, pose = time.monotonic(), self._robot.pose
        self.speed_mps = self._robot.speed_mps
        if pose.x_m > 6.5 or pose.x_m < -6.5:
            self._east = pose.x_m < 0
        if int(now_s / 0.05) % 40 == 0:  # every two seconds
            goal = (7.8125 if self._east else -7.8125, 0.3125)
            self._goals.publish(self._messages.encode_goal(goal, "odom", 0))
        return now_s

    def kill_router(self) -> None:
        """Kill the router's process."""
        self._router.send_signal(signal.SIGKILL)
        self._router.wait()

    def heal(self) -> None:
        """Undo the fault."""
        self.gate.closed.clear()
        if self._router.poll() is not None:
            self._router = self._open_router()

    def close(self) -> None:
        """End all processes."""
        for process in (self._driver, self._router):
            process.kill()
            process.wait()
        self._node.close()
        self._robot.close()

    def _open_router(self) -> "subprocess.Popen[str]":
        process = subprocess.Popen([sys.executable, "-c", ROUTER, self._endpoint], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        process.stdout.readline()
        return process

    def _heard(self, received: Any) -> None:
        velocity = self._messages.decode_twist(received.data)
        if velocity.speed_mps == 0.0 and velocity.turn_rad_s == 0.0:
            self.zeros.append(received.arrived_s)

    def _read(self) -> None:
        assert self._driver.stdout is not None
        for line in self._driver.stdout:
            if re.search(r"s  stop: ", line):
                self.stops.append((time.monotonic(), line.strip()))


def faults(bundle: Path, count: int, file: Path) -> dict[str, float]:
    """Cut pictures, odometry and router so often each, and return the worst and middle times."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    rng = np.random.default_rng(len(rows))
    left = {cut: count - sum(row["cut"] == cut for row in rows) for cut in CUTS}
    if any(number > 0 for number in left.values()):
        drive = FaultyDrive(bundle)
        try:
            while any(number > 0 for number in left.values()):
                for cut in CUTS:
                    if left[cut] > 0:
                        row = one_fault(drive, cut, float(rng.uniform(0, 0.3)))
                        rows.append(row)
                        with file.open("a") as out:
                            out.write(json.dumps(row) + "\n")
                        left[cut] -= 1
        finally:
            drive.close()
    return summary(rows)


def summary(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return middle and worst times of the cuts."""
    figures: dict[str, float] = {}
    for cut in CUTS:
        those = [row for row in rows if row["cut"] == cut]
        for what in ("zero_s", "stands_s"):
            times = [row[what] for row in those]
            figures[f"{cut}_{what}_p50"], figures[f"{cut}_{what}_max"] = float(np.median(times)), max(times)
        figures[f"{cut}_count"] = len(those)
    return figures


def virtual_fault(cut: str, seed: int) -> dict[str, Any]:
    """Return what `one_fault` returns, of robot and driver in one thread; the driver knows only to go straight on."""
    sys.path.append(str(Path(__file__).parents[1] / "tests"))
    from robots import Chain, Straight

    from zsdist.config import parse
    from zsdist.piloting.limits import STANDSTILL
    from zsdist.piloting.loop import DriveSettings
    from zsdist.planning.grid import Grid
    from zsdist.sim.scenes.scene import Scene, Start

    rng = np.random.default_rng([seed, *cut.encode()])
    scene = Scene("lane", "asphalt", Start(-8.4375, 0.3125, 0.0), (8.4375, 0.3125), ())
    settings = DriveSettings(goal=scene.goal, armed=True)
    small = parse({"camera": {"size_px": 32}})
    chain = Chain(scene, Straight(Grid()), Grid(), settings, config=small)
    chain.run(float(rng.uniform(3, 8)))
    chain.run(60, lambda chain: chain.robot.speed_mps > rng.uniform(0.3, 0.7))
    speed, cut_s = chain.robot.speed_mps, chain.topics.time_s
    chain.commander.connected = cut != "router"
    chain.topics.lost |= {"pictures": {"/camera/image/compressed"}, "odometry": {"/odom"}}.get(cut, set())
    if cut == "router":
        chain.topics.lost |= {"/camera/image/compressed", "/odom", "/clock"}
    stands_s = math.nan
    while chain.topics.time_s < cut_s + 1.5:
        chain.step()
        stands = abs(chain.robot.speed_mps) < 0.05
        stands_s = (chain.topics.time_s - cut_s if math.isnan(stands_s) else stands_s) if stands else math.nan
    zeros = [at_s - cut_s for at_s, velocity in chain.commander.sent if at_s > cut_s and velocity == STANDSTILL]
    chain.robot.close()
    row = {"cut": cut, "speed_mps": round(speed, 3), "zero_s": round(min(zeros, default=99.0), 3)}
    row["stands_s"] = 99.0 if math.isnan(stands_s) else round(stands_s, 3)
    print(row, flush=True)
    return row


def one_fault(drive: FaultyDrive, cut: str, wait_s: float) -> dict[str, Any]:
    """Wait until the robot is fast, cut, and measure."""
    fast_since = math.inf
    give_up_s = time.monotonic() + 120
    while time.monotonic() - fast_since < wait_s:
        now_s = drive.step()
        fast_since = min(fast_since, now_s) if drive.speed_mps > 0.3 else math.inf
        assert now_s < give_up_s, f"the robot does not drive; the driver's last stops: {drive.stops[-3:]}"
    speed = drive.speed_mps
    cut_s = time.monotonic()
    if cut == "router":
        drive.kill_router()
    else:
        drive.gate.closed.add({"pictures": "/camera/image/compressed", "odometry": "/odom"}[cut])
    stands_s = math.nan
    while (now_s := drive.step()) < cut_s + 1.5:
        if abs(drive.speed_mps) < 0.05:
            stands_s = min(stands_s, now_s - cut_s) if not math.isnan(stands_s) else now_s - cut_s
        else:
            stands_s = math.nan
    # A zero cannot be heard without a router: then the driver's own line says when it was commanded.
    said = [at_s for at_s, _ in drive.stops if at_s > cut_s]
    zeros = said if cut == "router" else [at_s for at_s in drive.zeros if at_s > cut_s]
    drive.heal()
    row = {"cut": cut, "speed_mps": round(speed, 3), "zero_s": round(min(zeros, default=math.inf) - cut_s, 3)}
    row["stands_s"] = round(stands_s, 3) if not math.isnan(stands_s) else 99.0
    print(row, flush=True)
    return row


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
