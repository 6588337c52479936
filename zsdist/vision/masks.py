"""Masks of Algorithm 1: parts of a picture that are hidden in turn, and the reward labels of what is left.

Nothing here knows where a picture comes from: a simulator and a data set of photographs hand over the same arrays.
"""

from dataclasses import dataclass

import numpy as np

from zsdist.vision.labels import nearest, openness, reward_label

MOST_MASKS = 16
TRIVIAL_SHARE = 0.002  # of the picture's pixels; whatever shows fewer is left out
GREATEST_SHARE = 0.9  # nothing can be told from a picture that is hidden nearly whole
CHANGED_REWARD = 0.05  # a label that differs by more has changed
BACKGROUND_WEIGHT = 0.5  # the weight stitched to the R_i of a background mask; an object's is 1
_GROUND_PATCHES = 3  # left, middle and right
_NEAREST_SHARE = 0.02  # of an object's pixels may be nearer than it is: measured depths have stray values


@dataclass(frozen=True)
class Mask:
    """One part of a picture to be hidden, and the truth of the scene without what is there, for R rays.

    Attributes:
        hidden: `(px, px)` bool.
        background: whether it is ground, sky or far things; the truth is then that of the whole scene.
        ray_distance_m: `(R,)` float32, capped at the camera's range.
        ray_dynamic: `(R,)` bool, whether the ray meets something of a kind that moves.
    """

    hidden: np.ndarray
    background: bool
    ray_distance_m: np.ndarray
    ray_dynamic: np.ndarray


@dataclass(frozen=True)
class MaskedView:
    """One picture, its truth as of `Mask`, and at most `MOST_MASKS` masks.

    Attributes:
        image: `(px, px, 3)` uint8.
        ray_distance_m: `(R,)` float32.
        ray_dynamic: `(R,)` bool.
        masks: of this picture.
        scene_hash: as of the views without masks, by which pictures of one scene can be kept together.
    """

    image: np.ndarray
    ray_distance_m: np.ndarray
    ray_dynamic: np.ndarray
    masks: tuple[Mask, ...]
    scene_hash: str


@dataclass(frozen=True)
class MaskedExamples:
    """Encoded masked pictures of a set of originals.

    Attributes:
        tokens: `(M, side, side, features)` float16.
        image: `(M,)` int64, the index of each one's original.
        ray_distance_m: `(M, R)` float32, of the scene without what is hidden; the original's for background.
        ray_dynamic: `(M, R)` bool, likewise.
        background: `(M,)` bool.
    """

    tokens: np.ndarray
    image: np.ndarray
    ray_distance_m: np.ndarray
    ray_dynamic: np.ndarray
    background: np.ndarray

    def __len__(self) -> int:
        return len(self.tokens)


def hide(image: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """The picture `(px, px, 3)` uint8 with the `hidden` `(px, px)` pixels in the mean colour of the others.

    A flat patch has no texture that an encoder could take for a thing, and the picture keeps its overall colour and
    brightness, which black would not; painting in what may be behind would need a model of its own.

    Raises:
        ValueError: the mask is no `(px, px)` bool array, or nothing of the picture is left.
    """
    if hidden.shape != image.shape[:2] or hidden.dtype != np.bool_:
        raise ValueError(f"a mask is {hidden.shape} {hidden.dtype}; allowed for this picture is {image.shape[:2]} bool")
    if hidden.all():
        raise ValueError("a mask hides the whole picture; allowed is less")
    result = image.copy()
    result[hidden] = np.rint(image[~hidden].mean(0)).astype(np.uint8)
    return result


def choose_masks(
    instances: np.ndarray, distance_m: np.ndarray, ground: np.ndarray, sky: np.ndarray, range_m: float
) -> tuple[dict[int, np.ndarray], list[np.ndarray]]:
    """The masks of a picture, `(px, px)` bool each, none trivial and at most `MOST_MASKS` in all.

    Each object within the range has one of its own; where there are too many, the smallest go. What is farther is
    one mask of the background, and so is the sky, and the ground at the left, in the middle and at the right.

    Args:
        instances: `(px, px)` int, the number of the object that each pixel shows; below 0: none.
        distance_m: `(px, px)` horizontal distance of what each pixel shows; infinite where it is not known.
        ground: `(px, px)` bool, ground that one could drive on.
        sky: `(px, px)` bool.
        range_m: of the camera.

    Returns:
        The objects' masks by their numbers, the largest first, and the background's.
    """
    numbers, counts = np.unique(instances[instances >= 0], return_counts=True)
    objects = {}
    for number in numbers[np.argsort(-counts, kind="stable")].tolist():
        hidden = instances == number
        if np.quantile(distance_m[hidden], _NEAREST_SHARE, method="lower") < range_m:
            objects[number] = hidden
    far = ~ground & ~sky & (distance_m >= range_m) & ~np.isin(instances, list(objects))
    patch = np.arange(ground.shape[1]) * _GROUND_PATCHES // ground.shape[1]
    patches = [ground & (patch == k) for k in range(_GROUND_PATCHES)]
    background = [hidden for hidden in (*patches, sky, far) if _worthy(hidden)]
    worthy = {number: hidden for number, hidden in objects.items() if _worthy(hidden)}
    return dict(list(worthy.items())[: MOST_MASKS - len(background)]), background


def rewards(
    ray_distance_m: np.ndarray,
    ray_dynamic: np.ndarray,
    ray_angles_rad: np.ndarray,
    progress: np.ndarray,
    goal_distance_m: np.ndarray,
) -> np.ndarray:
    """R, or R_i, `(B, 3)`, from the truth of a scene and a goal.

    Args:
        ray_distance_m: `(B, R)`.
        ray_dynamic: `(B, R)` bool.
        ray_angles_rad: `(R,)`.
        progress: `(B, 3)`, as of `labels.progress`.
        goal_distance_m: `(B,)`.
    """
    clearance_m, dynamic = nearest(ray_distance_m, ray_dynamic, ray_angles_rad)
    return reward_label(openness(clearance_m, dynamic, goal_distance_m[:, None]), progress)


def labels_changed(rewards_without: np.ndarray, rewards_with: np.ndarray) -> np.ndarray:
    """For which actions a masked picture is a positive sample, bool like both `(..., 3)`; for the others a negative.

    Args:
        rewards_without: R_i, of the scene without what is masked.
        rewards_with: R.
    """
    return np.abs(rewards_without - rewards_with) > CHANGED_REWARD


def pixel_distance_m(depth_m: np.ndarray, field_of_view_rad: float) -> np.ndarray:
    """Horizontal distance `(px, px)` of what each pixel of a level camera shows, from its depth along the axis."""
    px = depth_m.shape[1]
    slope = np.tan(field_of_view_rad / 2) * (1 - 2 * (np.arange(px) + 0.5) / px)
    return depth_m * np.sqrt(1 + slope**2)


def _worthy(hidden: np.ndarray) -> bool:
    return TRIVIAL_SHARE <= hidden.mean() <= GREATEST_SHARE
