"""Comparison of the camera's back ends: milliseconds per picture on one core, and their agreement.

`python benchmarks/camera.py [--quick] [--views N]` prints a table, then one JSON line. The agreement is measured over N
views from random free poses in all families, with the roll and pitch that the car has while it drives.
"""

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
from rich.progress import track

from zsdist.config import CameraConfig
from zsdist.datasets.sampling import free_pose
from zsdist.sim.camera import make_camera
from zsdist.sim.scenes import families
from zsdist.sim.scenes.scene import Scene
from zsdist.types import Pose

FAMILIES = ("iid", "street", "ood-all")
ALL_FAMILIES = tuple(families.FAMILIES)
MOST_ROLL_DEG, MOST_PITCH_DEG = 0.3, 3.0  # largest angles of the car while it drives
BACK_ENDS = ("caster", "pybullet")
SIZES_PX = (224, 128, 64)
DEPTH_TOLERANCE_M = 0.02
VIEWS_A_PROCESS = 40


def main() -> None:
    """Measure, print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer scenes, repeats; takes at most 50 s on two cores")
    parser.add_argument("--views", type=int, default=60, metavar="N", help="number of views compared (default: 60)")
    options = parser.parse_args()
    quick = options.quick
    began = time.perf_counter()
    make_camera(CameraConfig(size_px=32)).render(_scenes(1)[0], Pose(0.0, 0.0, 0.0))
    figures = {"first_picture_s": round(time.perf_counter() - began, 3)}  # numba compiles, or reads its cache
    scenes = _scenes(2 if quick else 4)
    rng = np.random.default_rng(0)
    views = [(scene, free_pose(scene, rng)) for scene in scenes for _ in range(5 if quick else 10)]
    figures |= _speed(views, repeats=2 if quick else 3) | _agreement(options.views)
    ratios = {
        f"caster_vs_tiny_{size}px": round(figures[f"pybullet_{size}px_ms"] / figures[f"caster_{size}px_ms"], 2)
        for size in SIZES_PX
    }
    for name, value in (figures | ratios).items():
        print(f"{name:40s} {value}")
    machine = {"machine": platform.machine(), "cpus": os.cpu_count(), "python": platform.python_version()}
    print(json.dumps({"subject": "camera", "machine": machine, "figures": figures, "ratios": ratios}))


def _scenes(of_each: int) -> list[Scene]:
    return [families.draw(family, "test", index) for index in range(of_each) for family in FAMILIES]


def _speed(views: list[tuple[Scene, Pose]], repeats: int) -> dict[str, float]:
    """Return median milliseconds of `render` and of `render_labelled` (with depth and segments) in a prepared scene.

    The back ends alternate. `new_scene` is the time of a first picture, including the preparation of the scene.
    """
    figures = {}
    for size in SIZES_PX:
        cameras = {name: make_camera(CameraConfig(back_end=name, size_px=size)) for name in BACK_ENDS}
        pictures, labelled, prepare = ({name: [] for name in BACK_ENDS} for _ in range(3))
        last = None
        for scene, pose in views:
            for name, camera in cameras.items():
                if scene is not last:
                    prepare[name].append(_milliseconds(camera.render, scene, pose))
                for _ in range(repeats):
                    pictures[name].append(_milliseconds(camera.render, scene, pose))
                    labelled[name].append(_milliseconds(camera.render_labelled, scene, pose))
            last = scene
        for name in BACK_ENDS:
            figures[f"{name}_{size}px_ms"] = round(statistics.median(pictures[name]), 3)
            figures[f"{name}_{size}px_labelled_ms"] = round(statistics.median(labelled[name]), 3)
            figures[f"{name}_{size}px_new_scene_ms"] = round(statistics.median(prepare[name]), 2)
    return figures


def _milliseconds(draw: Callable[[Scene, Pose], object], scene: Scene, pose: Pose) -> float:
    began = time.thread_time()  # CPU time of this thread, so that other load on the machine does not count
    draw(scene, pose)
    return 1e3 * (time.thread_time() - began)


def _agreement(views: int) -> dict[str, float]:
    """Return shares of pixels with equal segments, and with depths within tolerance: the mean and the worst picture.

    PyBullet never frees the Python objects of a mesh passed to it, about 30 MiB per scene, so a process handles at
    most `VIEWS_A_PROCESS` views.
    """
    parts = [range(first, min(first + VIEWS_A_PROCESS, views)) for first in range(0, views, VIEWS_A_PROCESS)]
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as process:
        results = process.map(_agreements, parts)
        pairs = [pair for part in track(results, total=len(parts), description="views compared") for pair in part]
    segments, depths = zip(*pairs, strict=True)
    return {
        "pictures_compared": views,
        "segments_equal_share": round(float(np.mean(segments)), 5),
        "segments_equal_share_worst_picture": round(float(np.min(segments)), 5),
        "depth_within_2cm_share": round(float(np.mean(depths)), 5),
        "depth_within_2cm_share_worst_picture": round(float(np.min(depths)), 5),
    }


def _agreements(indices: range) -> list[tuple[float, float]]:
    """Return both shares for each view, from a random pose in a scene; the families alternate."""
    ours, theirs = (make_camera(CameraConfig(back_end=name)) for name in BACK_ENDS)
    shares = []
    for index in indices:
        rng = np.random.default_rng((0, index))
        scene = families.draw(ALL_FAMILIES[index % len(ALL_FAMILIES)], "test", index // len(ALL_FAMILIES))
        view = (
            free_pose(scene, rng),
            *np.radians(rng.uniform((-MOST_ROLL_DEG, -MOST_PITCH_DEG), (MOST_ROLL_DEG, MOST_PITCH_DEG))),
        )
        _, depth, segment = ours.render_labelled(scene, *view)
        _, their_depth, their_segment = theirs.render_labelled(scene, *view)
        same = segment == their_segment
        seen = same & np.isfinite(depth) & np.isfinite(their_depth)
        near = np.abs(depth[seen] - their_depth[seen]) <= DEPTH_TOLERANCE_M
        # No pixel is left if a surface nearer than PyBullet's near plane fills the picture; then the share is 0.
        shares.append((float(np.mean(same)), float(np.mean(near)) if len(near) else 0.0))
    return shares


if __name__ == "__main__":
    main()
