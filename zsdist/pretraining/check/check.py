"""Check of a trained visual-act model against yardsticks that know less or more, on pictures not used for any choice.

A part for which the weights folder lacks something is left out and listed under "left_out" with the reason.
"""

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from zsdist.common import output_files, random_streams
from zsdist.common.console import say
from zsdist.config import CameraConfig, Config, VisionConfig
from zsdist.errors import RunError, WeightsError
from zsdist.evaluation.statistics import wilson_95
from zsdist.pretraining.check import objects, words
from zsdist.pretraining.check.predictions import CALIBRATED_SHARE, Predictions, predict
from zsdist.pretraining.check.sets import SETS, Sample, of_set, wilderness
from zsdist.sim.scenes.kinds import SIGHT_HEIGHT_M
from zsdist.vision.encoders import open_encoder
from zsdist.vision.labels import nearest, openness, progress, reward_label
from zsdist.vision.rays import RAYS, ray_angles_rad
from zsdist.vision.scores import action_scores, depth_rays_m, ray_scores
from zsdist.vision.visual_act import ALONE, VisualAct

FIGURES = ("best_action_accuracy", "regret", "mae", "miss_rate", "false_alarm_rate")
YARDSTICKS = ("always_forward", "goal_only", "depth_oracle")
SET_FIGURES = ("best_action_accuracy", "miss_rate", "false_alarm_rate", "calibration_10", "calibration_10_all_rays")
OBJECTS = 60  # number of objects that the car approaches
_TIMED = 40  # number of pictures whose time is measured, one at a time
_UNTIMED = 5  # number of pictures before them, to warm up


def check(
    config: Config,
    images: int,
    seed: int,
    out: Path | None,
    object_count: int = OBJECTS,
    objects_file: Path | None = None,
    unseen_kinds: bool = False,
) -> dict[str, Any]:
    """Return figures of the trained model and of three yardsticks on the same new pictures; print and write them.

    The goals are random and mostly ahead, as for a car that drives to its goal. The yardsticks:

    * `always_forward` predicts that everything is free and the goal straight ahead;
    * `goal_only` knows the goal but no picture: every direction is equally open and every ray free;
    * `depth_oracle` has the true depth image and assumes that nothing moves: its errors cannot be avoided with
      distances from this viewpoint.

    Args:
        config: configuration with weights, camera and grid.
        images: number of pictures of the wilderness and of each set.
        seed: seed of all random choices.
        out: JSON file to write; None: no file.
        object_count: number of objects that the car approaches; 0: none.
        objects_file: file with a record of each of these objects, so that a measurement can be resumed; None: no file.
        unseen_kinds: whether to train projections without some kinds too, and measure them on these kinds.

    Raises:
        WeightsError: the weights cannot be used.
        RunError: a file cannot be written, or the objects file cannot be resumed.
    """
    if out is not None:
        output_files.check_place("--json", out)
    model = VisualAct.load(config.vision, config.camera)
    depth_rays: list[np.ndarray] = []
    left_out: dict[str, str] = {}
    observations = words.Observations.create(model, config, left_out)
    rng = random_streams.check_goals(seed)

    def on_batch(batch: list[Sample]) -> None:
        depth_rays.extend(_depth_rays(sample.depth_m, config.camera) for sample in batch)

    wild = predict(model, wilderness(images, seed, config.camera), config.vision.ray_quantile, rng, on_batch)
    if observations is not None:
        observations.add_wilderness(images, seed, config)
    log(f"wilderness: {images} pictures done")
    sets = {}
    for name in SETS:
        pictures = of_set(name, images, seed, config.camera)
        sets[name] = predict(model, pictures, config.vision.ray_quantile, rng)
        log(f"{SETS[name].title}: {images} pictures done")
    result = {
        "images": images,
        **wild.scores(),
        **yardsticks(wild, np.stack(depth_rays), config.camera),
        "families": {family: wild.scores(wild.families == family) for family in dict.fromkeys(wild.families.tolist())},
        "sets": summarise_sets({name: predictions.set_scores() for name, predictions in sets.items()}),
        "objects": {"one_look": unseen_in_one_picture([wild, *sets.values()])},
        **(observations.figures() if observations is not None else {}),
        **words.naming(config, seed, images, unseen_kinds, left_out),
        "ms_per_image": milliseconds(config, seed, left_out),
        "seed": seed,
        "network": config.vision.network,
        "ray_quantile": config.vision.ray_quantile,
        "encoder": model.encoder_name,
        "weights_sha256": model.weights_sha256,
    }
    if object_count:
        driven = objects.measure(model, config, object_count, seed, objects_file, log)
        result["objects"]["after_drive_up"] = driven
    else:
        left_out["objects.after_drive_up"] = "--objects 0"
    result["left_out"] = left_out
    result = without_nan(result)
    show(result)
    if out is not None:
        try:
            out.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise RunError(f"--json {out} cannot be written: {error.strerror or error}") from error
    return result


def yardsticks(wild: Predictions, depth_rays: np.ndarray, camera: CameraConfig) -> dict[str, dict[str, float]]:
    """Return the figures of the yardsticks of `check`; `depth_rays` `(N, R)` are the depth oracle's distances."""
    gain, goal_m = progress(wild.goal_bearing_rad, wild.goal_distance_m), wild.goal_distance_m[:, None]
    angles = ray_angles_rad(RAYS, math.radians(camera.field_of_view_deg))
    clearance_m, still = nearest(depth_rays, np.zeros(depth_rays.shape, bool), angles)
    free = np.full_like(wild.true_rays_m, camera.range_m)
    straight = np.tile(reward_label(np.array(1.0, np.float32), progress(np.array(0.0), np.array(10.0))), (len(free), 1))
    predictions = (
        (straight, free),
        (reward_label(np.array(0.5, np.float32), gain), free),
        (reward_label(openness(clearance_m, still, goal_m), gain), depth_rays),
    )
    return {
        name: action_scores(rewards, wild.labels) | ray_scores(rays, wild.true_rays_m)
        for name, (rewards, rays) in zip(YARDSTICKS, predictions, strict=True)
    }


def summarise_sets(scores: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Return the figures of each set, their median and the worst; for calibration the one farthest from its target."""

    def badness(key: str, value: float) -> float:
        if key == "best_action_accuracy":
            return -value
        return abs(value - CALIBRATED_SHARE) if key.startswith("calibration") else value

    columns = {key: [row[key] for row in scores.values() if math.isfinite(row[key])] for key in SET_FIGURES}
    known = {key: values for key, values in columns.items() if values}
    return scores | {
        "median": {key: float(np.median(values)) for key, values in known.items()},
        "worst": {key: max(values, key=partial(badness, key)) for key, values in known.items()},
    }


def unseen_in_one_picture(predictions: Iterable[Predictions]) -> dict[str, Any]:
    """Return number and share of near objects that are completely unseen in one picture, at the configured quantile."""
    near, unseen = np.sum([each.unseen() for each in predictions], axis=0).tolist()
    return {"objects": near, "unseen": unseen} | (
        {"share": unseen / near, "confidence_95": list(wilson_95(unseen, near))} if near else {}
    )


def milliseconds(config: Config, seed: int, left_out: dict[str, str]) -> dict[str, float]:
    """Return the median milliseconds for one new picture at a time.

    `trunk` is the encoder alone, `head` the prediction by encoder and head, the others are networks without an encoder.
    """
    pictures = [sample.image[None] for sample in wilderness(_TIMED + _UNTIMED, seed + 1, config.camera)]
    times = {}
    for name in ("head", *ALONE):
        try:
            network = VisionConfig(**config.vision.model_dump() | {"network": name})
            times[name] = _median_ms(VisualAct.load(network, config.camera).read, pictures)
        except WeightsError as error:
            left_out[f"ms_per_image.{name}"] = str(error)
    try:
        times["trunk"] = _median_ms(open_encoder(config.vision.encoder).tokens, pictures)
    except WeightsError as error:
        left_out["ms_per_image.trunk"] = str(error)
    return times


def without_nan(tree: Any) -> Any:
    """Return a tree of figures without the unknown ones (NaN)."""
    if isinstance(tree, Mapping):
        return {
            key: without_nan(value)
            for key, value in tree.items()
            if not (isinstance(value, float) and math.isnan(value))
        }
    return tree


def log(line: str) -> None:
    """Print a line of progress."""
    say(line)


def show(result: dict[str, Any]) -> None:
    """Print all figures of a check."""
    rows = {"model": result} | {name: result[name] for name in YARDSTICKS} | result["families"]
    _table(rows, FIGURES)
    _table(result["sets"], SET_FIGURES)
    for name, figures in result["objects"].items():
        if "share" in figures:
            low, high = figures["confidence_95"]
            say(
                f"whole objects unseen, {name.replace('_', ' ')}: {figures['unseen']} of {figures['objects']} = "
                f"{figures['share']:.2%} (95%: {low:.2%} to {high:.2%})"
            )
    words.show(result)
    times = ", ".join(f"{name} {value:.2f}" for name, value in result["ms_per_image"].items())
    say(f"{result['images']} pictures a set, seed {result['seed']}; ms an image: {times}")
    for name, reason in result["left_out"].items():
        say(f"left out: {name}: {reason}")


def _table(rows: dict[str, dict[str, float]], keys: tuple[str, ...]) -> None:
    """Print a table of figures, with a row for each name."""
    say("")
    say(" " * 22 + "".join(f"{key:>24}" for key in keys))
    for name, row in rows.items():
        say(f"{name:22}" + "".join(f"{row[key]:24.3f}" if key in row else f"{'-':>24}" for key in keys))


def _median_ms(forward: Callable[[np.ndarray], Any], images: list[np.ndarray]) -> float:
    times = []
    for image in images:
        begin = time.perf_counter()
        forward(image)
        times.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(times[_UNTIMED:]))


def _depth_rays(depth_m: np.ndarray, camera: CameraConfig) -> np.ndarray:
    """Return the distances `(R,)` in metres along the rays of a depth image `(px, px)`."""
    return depth_rays_m(
        depth_m, RAYS, math.radians(camera.field_of_view_deg), camera.height_m, camera.range_m, SIGHT_HEIGHT_M
    )
