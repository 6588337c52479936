"""A trained visual-act model beside yardsticks that know less or more than it does, on pictures of unseen families."""

import itertools
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from zsdist.config import CameraConfig, Config
from zsdist.errors import RunError
from zsdist.pretraining.batches import BATCH, batched
from zsdist.sim.camera import make_camera
from zsdist.sim.families import generate
from zsdist.sim.kinds import SIGHT_HEIGHT_M
from zsdist.sim.manifest import OOD_FAMILIES, SPLITS, split_seed
from zsdist.sim.views import POSES_PER_SCENE, free_pose, label
from zsdist.vision.labels import nearest, openness, progress, random_goals, reward_label
from zsdist.vision.rays import RAYS, quantile_m, ray_angles_rad
from zsdist.vision.scores import action_scores, depth_rays_m, ray_scores
from zsdist.vision.visual_act import VisualAct


class Wild(NamedTuple):
    """A picture of the wilderness, its depth image, and its family's name and truth."""

    image: np.ndarray
    depth_m: np.ndarray
    family: str
    truth: dict[str, np.ndarray]


def wilderness(count: int, seed: int, camera: CameraConfig) -> Iterator[Wild]:
    """Pictures of scenes from the families and seeds that are kept for tests, as they look when driven through."""
    rng = np.random.default_rng([seed, 2])
    eye, made = make_camera(camera), 0
    for family in itertools.cycle(OOD_FAMILIES):
        scene = generate(family, split_seed("test", int(rng.integers(len(SPLITS["test"])))))
        for _ in range(min(POSES_PER_SCENE, count - made)):
            pose = free_pose(scene, rng)
            image, depth_m, _ = eye.render_labelled(scene, pose)
            yield Wild(image, depth_m, family, label(scene, pose, camera))
            made += 1
        if made == count:
            return


def check(config: Config, count: int, seed: int, out: Path | None) -> dict[str, Any]:
    """Figures of the trained model and of three yardsticks on the same fresh pictures, printed and written as JSON.

    The goals are random and mostly ahead, as they are to a car that drives to one. The yardsticks:

    * `always_forward` says that everything is free and the goal straight ahead, whatever is there;
    * `goal_only` knows the goal and looks at nothing: every direction is equally open and every ray free;
    * `depth_oracle` has the true depth image instead of the picture and takes everything to stand still: what
      remains is what no look at distances from there could tell.

    Raises:
        WeightsError: the weights cannot be used.
        RunError: the file cannot be written.
    """
    model = VisualAct.load(config.vision, config.camera)
    angles = ray_angles_rad(RAYS, math.radians(config.camera.field_of_view_deg))
    bearing, distance = random_goals(count, np.random.default_rng([seed, 3]))
    said, said_rays, depth_rays, truths, families, times = [], [], [], [], [], []
    for start, batch in zip(itertools.count(0, BATCH), batched(wilderness(count, seed, config.camera), BATCH)):
        rows, images = slice(start, start + len(batch)), np.stack([wild.image for wild in batch])
        begin = time.perf_counter()
        views = model(images, bearing[rows], distance[rows])
        times.append((time.perf_counter() - begin) / len(batch))
        said += [view.advice for view in views]
        said_rays += [quantile_m(view.ray_probabilities, config.vision.ray_quantile) for view in views]
        depth_rays += [_depth_rays(wild.depth_m, config.camera) for wild in batch]
        truths += [wild.truth for wild in batch]
        families += [wild.family for wild in batch]
    gain, goal_m = progress(bearing, distance), distance[:, None]
    true_rays = np.stack([truth["ray_clearance_m"] for truth in truths])
    clearance_m, dynamic = (np.stack([truth[key] for truth in truths]) for key in ("clearance_m", "dynamic"))
    labels = reward_label(openness(clearance_m, dynamic, goal_m), gain)
    depth_rays, said, said_rays = np.stack(depth_rays), np.stack(said), np.stack(said_rays)
    depth_clearance_m, still = nearest(depth_rays, np.zeros(depth_rays.shape, bool), angles)
    free = np.full_like(true_rays, config.camera.range_m)
    straight = np.tile(reward_label(1.0, progress(0.0, 10.0)), (count, 1))
    yardsticks = {
        "always_forward": (straight, free),
        "goal_only": (reward_label(0.5, gain), free),
        "depth_oracle": (reward_label(openness(depth_clearance_m, still, goal_m), gain), depth_rays),
    }

    def score(rewards: np.ndarray, rays: np.ndarray, of: np.ndarray | slice = slice(None)) -> dict[str, float]:
        return action_scores(rewards[of], labels[of]) | ray_scores(rays[of], true_rays[of])

    result = {
        "images": count,
        **score(said, said_rays),
        **{name: score(*reading) for name, reading in yardsticks.items()},
        "families": {
            family: score(said, said_rays, np.array(families) == family) for family in dict.fromkeys(families)
        },
        "ms_per_image": 1e3 * float(np.median(times)),
        "seed": seed,
        "encoder": model.encoder_name,
        "weights_sha256": model.weights_sha256,
    }
    _show(result)
    if out is not None:
        try:
            out.write_text(json.dumps(result, indent=1) + "\n")
        except OSError as error:
            raise RunError(f"--json {out} cannot be written: {error.strerror or error}") from error
    return result


def _depth_rays(depth_m: np.ndarray, camera: CameraConfig) -> np.ndarray:
    return depth_rays_m(
        depth_m, RAYS, math.radians(camera.field_of_view_deg), camera.height_m, camera.range_m, SIGHT_HEIGHT_M
    )


def _show(result: dict[str, Any]) -> None:
    keys = ("best_action_accuracy", "regret", "mae", "miss_rate", "false_alarm_rate")
    rows = {"model": result} | {name: result[name] for name in ("always_forward", "goal_only", "depth_oracle")}
    rows |= result["families"]
    print(" " * 16 + "".join(f"{key:>22}" for key in keys))
    for name, row in rows.items():
        print(f"{name:16}" + "".join(f"{row[key]:22.3f}" for key in keys))
    print(f"{result['images']} pictures, {result['ms_per_image']:.1f} ms each, seed {result['seed']}")
