"""Measurements of a runner in its own environment, printed as one JSON line; `bundle.py` starts it.

It imports nothing but what an exported policy needs.
"""

import json
import os
import resource
import sys
import time
from importlib.metadata import distributions
from pathlib import Path

PASSES = 5  # a step's least time of these is what the code needs; the host's other work is in all others
HEAVY = {"torch", "ray", "pybullet", "scipy"}


def main(folder: Path) -> dict[str, object]:
    """Return the figures of the runner of the bundle in a folder."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    began_s = time.perf_counter()
    from zsdist.runtime.bundle import Bundle
    from zsdist.runtime.runner import BundleRunner

    imported_s = time.perf_counter() - began_s
    import numpy as np
    import safetensors.numpy

    from zsdist.types import Pose

    bundle = Bundle.load(folder)
    runner = BundleRunner(bundle)
    start = Pose(-5.0, -5.0, 0.0)
    runner.begin(start, (5.0, 5.0))
    runner.decide(np.zeros((bundle.camera.height_px, bundle.camera.width_px, 3), np.uint8), start)
    ready_s = time.perf_counter() - began_s
    used_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    steps = safetensors.numpy.load_file(folder / "parity.safetensors")
    wall_ms, cpu_ms, same = np.zeros((PASSES, len(steps["action"]))), np.zeros((PASSES, len(steps["action"]))), 0
    for number in range(PASSES):
        for step, (picture, pose, goal) in enumerate(zip(steps["picture"], steps["pose"], steps["goal"], strict=True)):
            pose, goal = Pose(*pose.tolist()), tuple(goal.tolist())
            if step == 0 or steps["episode"][step] != steps["episode"][step - 1]:
                runner.begin(pose, goal)
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            decision = runner.decide(picture, pose)
            cpu_ms[number, step] = 1000 * (time.process_time() - cpu_s)
            wall_ms[number, step] = 1000 * (time.perf_counter() - wall_s)
            same += decision.action == steps["action"][step]
    quantiles = {
        f"{kind}_ms_p{share}": float(np.quantile(values, share / 100))
        for kind, values in (
            ("decision_wall", wall_ms),
            ("decision_cpu", cpu_ms),
            ("decision_least", wall_ms.min(axis=0)),
        )
        for share in (50, 99)
    }
    return {
        "import_s": imported_s,
        "ready_s": ready_s,
        "memory_mb": used_mb,
        "steps": wall_ms.shape[1],
        "episodes": len(set(steps["episode"].tolist())),
        "same_action": same / wall_ms.size,
        "packages": sorted(f"{found.name} {found.version}" for found in distributions()),
        "heavy": sorted(HEAVY & {name.partition(".")[0] for name in sys.modules}),
        **quantiles,
    }


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]))))
