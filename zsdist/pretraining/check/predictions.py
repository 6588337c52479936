"""Predictions of a model for many pictures with the ground truth, and their scores."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from zsdist.pretraining.batches import BATCH, batched
from zsdist.pretraining.check.sets import Sample
from zsdist.vision.labels import openness, progress, random_goals, reward_label
from zsdist.vision.rays import RANGE_M, quantile_m
from zsdist.vision.scores import action_scores, calibration, ray_scores, unseen_objects
from zsdist.vision.visual_act import VisualAct

CALIBRATED_SHARE = 0.1  # quantile of the predicted distance below which true distances are counted


@dataclass(frozen=True)
class Predictions:
    """Predictions for N pictures with R rays, distances in K bins and random goals, and the ground truth.

    Attributes:
        advice: `(N, 3)`, predicted rewards R_p.
        clearance_m: `(N, 3)`, predicted clearances at the configured quantile.
        ray_probabilities: `(N, R, K)`, predicted distributions of the distance along each ray.
        rays_m: `(N, R)`, predicted distances along the rays at the configured quantile.
        labels: `(N, 3)`, true rewards.
        true_clearance_m: `(N, 3)`, true clearances.
        true_rays_m: `(N, R)`, true distances along the rays.
        objects: `(N, R)`, obstacle that each ray meets, as in `Sample`.
        families: `(N,)` str, families of the scenes.
        goal_bearing_rad: `(N,)`, direction of the goal from the car's heading, left positive.
        goal_distance_m: `(N,)`, distance of the goal.
    """

    advice: np.ndarray
    clearance_m: np.ndarray
    ray_probabilities: np.ndarray
    rays_m: np.ndarray
    labels: np.ndarray
    true_clearance_m: np.ndarray
    true_rays_m: np.ndarray
    objects: np.ndarray
    families: np.ndarray
    goal_bearing_rad: np.ndarray
    goal_distance_m: np.ndarray

    def scores(self, chosen: np.ndarray | slice = slice(None)) -> dict[str, float]:
        """Return the five figures of actions and rays, for all pictures or the chosen ones."""
        actions = action_scores(self.advice[chosen], self.labels[chosen])
        return actions | ray_scores(self.rays_m[chosen], self.true_rays_m[chosen])

    def set_scores(self) -> dict[str, float]:
        """Return the figures of a set of pictures."""
        scores = self.scores()
        quantile = quantile_m(self.ray_probabilities, CALIBRATED_SHARE)
        calibrated = calibration(quantile, self.true_rays_m, RANGE_M)
        return {
            "best_action_accuracy": scores["best_action_accuracy"],
            "miss_rate": scores["miss_rate"],
            "false_alarm_rate": scores["false_alarm_rate"],
            "calibration_10": calibrated["short"],
            "calibration_10_all_rays": calibrated["all"],
            "rays": int(self.true_rays_m.size),
            "rays_short_of_range": calibrated["rays"],
        }

    def unseen(self) -> tuple[int, int]:
        """Return the number of near objects, and of the unseen ones among them; see `scores.unseen_objects`."""
        return unseen_objects(self.objects, self.rays_m, self.true_rays_m)


def predict(
    model: VisualAct,
    samples: Iterable[Sample],
    quantile: float,
    rng: np.random.Generator,
    on_batch: Callable[[list[Sample]], None] = lambda batch: None,
) -> Predictions:
    """Return the predictions of a model for pictures, which are not kept.

    Args:
        model: model that makes the predictions.
        samples: pictures with ground truth, one or more.
        quantile: quantile of the predicted distribution that is used as the distance.
        rng: source of a goal for each picture, mostly ahead.
        on_batch: function that is called with each batch of pictures.
    """
    predicted, truths = [], []
    for batch in batched(samples, BATCH):
        bearing, distance = random_goals(len(batch), rng)
        views = model(np.stack([sample.image for sample in batch]), bearing, distance)
        probabilities = np.stack([view.ray_probabilities for view in views])
        predicted.append(
            (
                np.stack([view.advice for view in views]),
                np.stack([view.clearance_m for view in views]),
                probabilities,
                quantile_m(probabilities, quantile),
            )
        )
        clearance_m, dynamic, rays_m = (
            np.stack([sample.truth[key] for sample in batch]) for key in ("clearance_m", "dynamic", "ray_clearance_m")
        )
        labels = reward_label(openness(clearance_m, dynamic, distance[:, None]), progress(bearing, distance))
        objects, families = (
            np.stack([sample.objects for sample in batch]),
            np.array([sample.family for sample in batch]),
        )
        truths.append((labels, clearance_m, rays_m, objects, families, bearing, distance))
        on_batch(batch)
    columns = [np.concatenate(column) for rows in (predicted, truths) for column in zip(*rows, strict=True)]
    return Predictions(*columns)
