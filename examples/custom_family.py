"""Make a family of scenes of one's own: generate it, check it, drive the shipped policy in it, and train in it.

Usage: `python examples/custom_family.py [--scenes 8] [--out my-family] [--episodes 40]`. OUT is a new folder, which
every command takes as `--scenes` or in `scenes.train`. A family that belongs to zsdist itself, drawn by its name, is
added to `zsdist/sim/scenes/families.py`; CONTRIBUTING.md has the steps.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zsdist import launch
from zsdist.evaluate import find_policy
from zsdist.evaluation.report import evaluate
from zsdist.sim.scenes import scene as scene_files
from zsdist.sim.scenes.diagnosis import diagnose
from zsdist.sim.scenes.families_canvas import Canvas, Redraw
from zsdist.sim.scenes.scene import Obstacle, Scene
from zsdist.types import LatticeState

TRIES = 100
GATE_M = 4.0  # width of the gates


def gates(rng: np.random.Generator, name: str) -> Scene:
    """Return a scene with two walls from side to side, each with a gate, and bushes between them.

    Raises:
        Redraw: there was no room for the bushes.
    """
    start = LatticeState(2, int(rng.integers(4, 28)), 0)  # column, row and heading; the grid has 32 by 32 cells
    canvas = Canvas(rng, start, (29, int(rng.integers(4, 28))))
    for x_m in (-4.0, 4.0):
        gate_m = round(float(rng.uniform(-8.0, 8.0)), 2)
        for low_m, high_m in ((-12.4, gate_m - GATE_M / 2), (gate_m + GATE_M / 2, 12.4)):
            length_m = round(high_m - low_m, 2)
            canvas.obstacles.append(
                Obstacle("box", x_m, round((low_m + high_m) / 2, 2), None, (0.5, length_m, 2.0), 0.0)
            )
    canvas.scatter(4, {"bush": 1.0}, gap_m=2.0)
    return canvas.scene(name, "grass")


def generate(count: int, folder: Path, seed: int = 0) -> list[Scene]:
    """Write scenes of the family that can be driven into a new folder, and return them."""
    folder.mkdir(parents=True)
    made = []
    for number in range(count):
        rng = np.random.default_rng((seed, number))
        for _ in range(TRIES):
            try:
                scene = gates(rng, f"gates-{number:03d}")
            except Redraw:
                continue
            diagnosis = diagnose(scene)
            if diagnosis.reason is None:
                break
            print(f"{scene.name} is drawn again: {diagnosis.reason}")
        else:
            raise SystemExit(f"none of {TRIES} draws can be driven; make the gates wider")
        scene_files.write(scene, folder / f"{scene.name}.yaml")
        print(f"{scene.name}: {diagnosis.way_m:.1f} m")
        made.append(scene)
    return made


def main(arguments: Sequence[str] | None = None) -> tuple[list[Scene], float]:
    """Generate, drive and train; return the scenes and the success of the shipped policy in them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--out", type=Path, default=Path("my-family"))
    parser.add_argument("--episodes", default="40", help="training episodes; 0: no training")
    parser.add_argument("--run", default="runs/custom-family")
    parser.add_argument("--quick", action="store_true", help="a few seconds, to see that it works")
    options = parser.parse_args(arguments)
    quick: list[str] = []
    if options.quick:
        options.scenes, options.episodes = 2, "2"
        quick = ["sim.max_steps=10", "merge.every_episodes=0", "vision.network=student", "camera.size_px=128"]
    scenes = generate(options.scenes, options.out)
    shipped = find_policy("pretrained", overrides=tuple(quick[:1]))
    report = evaluate(
        shipped.contender,
        policy="pretrained",
        weights_sha256=shipped.weights_sha256,
        scenes=str(options.out),
        episodes=1 if options.quick else None,
        seed=0,
        workers=1,
    )
    success = report.result["success"]
    print(f"the policy that comes with zsdist: success {success:.2f}")
    if options.episodes != "0":
        words = ["--single-process", "--plain", "--episodes", options.episodes, "--run-dir", options.run]
        changes = [f"scenes.train={json.dumps([str(options.out)])}", "run.final_evaluation_episodes=0", *quick]
        words += [word for change in changes for word in ("--set", change)]
        launch.main(launch.make_parser().parse_args(words))
        print(f"trained: {options.run}; evaluate it with zsdist evaluate {options.run} --scenes {options.out}")
    return scenes, success


if __name__ == "__main__":
    main()
