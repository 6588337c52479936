"""Driving of the simulated car: accuracy, steps and time per action, and agreement of the collision tests.

`python benchmarks/car.py [--quick]` prints a table, then one JSON line.
"""

import argparse
import json
import math
import os
import platform
import statistics
import time
from collections import defaultdict

import numpy as np

from zsdist.planning.footprint import ADVANCES, TURNS, FootprintTable, successor
from zsdist.planning.grid import HEADINGS, Grid
from zsdist.sim.physics.world import World
from zsdist.sim.scenes.families import generate
from zsdist.sim.scenes.manifest import split_seed
from zsdist.sim.scenes.scene import Scene, Start
from zsdist.types import Action, LatticeState, Pose

SEQUENCE = 10  # number of actions in a sequence
SHARES = (0.4, 0.15, 0.15, 0.15, 0.15)  # share of each action, in the order of `Action`
WITHIN_M, WITHIN_DEG = 0.10, 5.0
FAMILIES = ("iid", "ood-layout", "ood-clusters", "ood-dynamic")
EMPTY = Scene("empty", "asphalt", Start(0.3125, 0.3125, 0.0), (8.0, 8.0), ())
GRID = Grid()


def main() -> None:
    """Measure, print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer sequences and poses; ends within 50 s on two cores")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sequences and poses")
    arguments = parser.parse_args()
    quick, rng = arguments.quick, np.random.default_rng(arguments.seed)
    world = World(GRID)
    scenes = [generate(family, split_seed("test", i)) for i in range(4 if quick else 25) for family in FAMILIES]
    figures = (
        _accuracy(world, rng, 120 if quick else 500)
        | _agreement(world, rng, scenes, 2000 if quick else 20_000)
        | _allowed_actions(world, rng, [scene for scene in scenes if not scene.walkers()], 25 if quick else 100)
        | _replays(world, scenes[: 8 if quick else 40])
        | _resets(world, scenes)
    )
    for name, value in figures.items():
        print(f"{name:36s} {value}")
    machine = {"machine": platform.machine(), "cpus": os.cpu_count(), "python": platform.python_version()}
    print(json.dumps({"subject": "car", "machine": machine, "figures": figures, "ratios": {}}))


def _accuracy(world: World, rng: np.random.Generator, sequences: int) -> dict[str, float]:
    """Return the errors of random actions in an empty arena, relative to their targets."""
    metres, degrees, tilts, steps = [], [], [], defaultdict(list)
    spent_s = 0.0
    for _ in range(sequences):
        world.reset(EMPTY, GRID.pose(LatticeState(16, 16, int(rng.integers(HEADINGS)))))
        before = None
        for action in rng.choice(len(Action), SEQUENCE, p=SHARES).tolist():
            end = successor(GRID.lattice_state(world.pose), action)
            began = time.process_time()  # CPU time, since other processes share the cores
            result = world.drive(action)
            spent_s += time.process_time() - began
            target = GRID.pose(end)
            metres.append(math.dist(result.pose[:2], target[:2]))
            degrees.append(abs(math.degrees(math.remainder(result.pose.heading_rad - target.heading_rad, math.tau))))
            tilts.append(np.degrees(world.tilt))
            steps[_kind(action, before, end.heading)].append(result.sim_steps)
            before = action
    counts = [count for kind in steps.values() for count in kind]
    within = (np.array(metres) <= WITHIN_M) & (np.array(degrees) <= WITHIN_DEG)
    figures = {"actions": len(metres), "within_tolerance_share": round(float(within.mean()), 4)}
    for name, errors, digits in (("position_error_m", metres, 3), ("heading_error_deg", degrees, 2)):
        p50, p99, most = np.percentile(errors, (50, 99, 100))
        figures |= {
            f"{name}_p50": round(p50, digits),
            f"{name}_p99": round(p99, digits),
            f"{name}_max": round(most, digits),
        }
    roll, pitch = np.abs(tilts).max(axis=0)
    figures |= {"roll_max_deg": round(roll, 2), "pitch_max_deg": round(pitch, 2)}
    figures |= {f"sim_steps_{kind}": round(statistics.fmean(steps[kind]), 1) for kind in sorted(steps)}
    return figures | {
        "sim_steps_mean": round(statistics.fmean(counts), 2),
        "sim_steps_max": max(counts),
        "cpu_us_an_action": round(1e6 * spent_s / len(metres)),
        "cpu_us_a_sim_step": round(1e6 * spent_s / sum(counts), 1),
    }


def _kind(action: int, before: int | None, heading: int) -> str:
    if not ADVANCES[action]:
        return "turn_90"
    kind = "turn_45_and_move" if TURNS[action] else "forward"
    flows = kind == "forward" and before is not None and ADVANCES[before]
    return kind + ("_diagonal" if heading % 2 else "") + ("_flowing" if flows else "")


def _agreement(world: World, rng: np.random.Generator, scenes: list[Scene], poses: int) -> dict[str, float]:
    """Return the agreement of PyBullet's contacts with the box test, at poses that often touch an obstacle."""
    ours, theirs = [], []
    each = -(-poses // len(scenes))
    for scene in scenes:
        world.reset(scene)
        for _ in range(each):
            world.put(Pose(*rng.uniform(-11.7, 11.7, 2), rng.uniform(-math.pi, math.pi)))
            ours.append(world.touches())
            theirs.append(world.contact())
    ours, theirs = np.array(ours), np.array(theirs)
    return {
        "agreement_poses": len(ours),
        "agreement_touching_share": round(float(ours.mean()), 3),
        "agreement_share": round(float((ours == theirs).mean()), 5),
        "agreement_only_ours": int((ours & ~theirs).sum()),
        "agreement_only_contacts": int((~ours & theirs).sum()),
    }


def _allowed_actions(world: World, rng: np.random.Generator, scenes: list[Scene], most: int) -> dict[str, float]:
    """Return the number of collisions in actions that the footprint table allows on the true map."""
    table = FootprintTable(GRID)
    driven = collisions = unconfirmed = 0
    for scene in scenes:
        blocked = table.blocked(scene.occupancy(GRID))
        world.reset(scene)
        for _ in range(most):
            state = GRID.lattice_state(world.pose)
            free = np.flatnonzero(~blocked[state.iy, state.ix, state.heading])
            if not len(free):
                break
            result = world.drive(int(rng.choice(free)))
            driven, collisions = driven + 1, collisions + result.contact
            unconfirmed += not result.confirmed
            if result.contact:
                break
    return {"allowed_actions": driven, "allowed_actions_collided": collisions, "unconfirmed_drives": unconfirmed}


def _replays(world: World, scenes: list[Scene]) -> dict[str, int]:
    """Return the number of drives that are not bit-identical when repeated after all others, or in a new world."""

    def drive(where: World, index: int) -> list[float]:
        rng = np.random.default_rng(index)
        where.reset(scenes[index])
        numbers = [*where.pose]
        for action in rng.choice(len(Action), SEQUENCE, p=SHARES).tolist():
            result = where.drive(action)
            numbers += [*result.pose, *where.tilt, result.sim_steps]
            if result.contact:
                break
        return numbers

    first = [drive(world, index) for index in range(len(scenes))]
    again = [drive(world, index) for index in reversed(range(len(scenes)))][::-1]
    fresh = World(GRID)
    apart = [drive(fresh, index) for index in range(len(scenes))]
    fresh.close()
    differing = sum(not one == two == three for one, two, three in zip(first, again, apart, strict=True))
    return {"replays": len(scenes), "replays_that_differ": differing}


def _resets(world: World, scenes: list[Scene]) -> dict[str, float]:
    """Return the median milliseconds of a reset to another scene, and to the same scene again."""
    spent = defaultdict(list)
    for scene in scenes:
        for case in ("new", "same"):
            began = time.perf_counter()
            world.reset(scene)
            spent[case].append(1e3 * (time.perf_counter() - began))
    return {f"reset_{case}_scene_ms": round(statistics.median(spent[case]), 2) for case in ("new", "same")}


if __name__ == "__main__":
    main()
