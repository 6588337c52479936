"""Masks of Algorithm 1: parts of a picture that are hidden one at a time, and reward labels of the remaining scene.

The source of a picture does not matter: the simulator and a data set of photographs provide the same arrays.
"""

from dataclasses import dataclass

import numpy as np

from zsdist.vision.labels import nearest, openness, reward_label

MOST_MASKS = 16
TRIVIAL_SHARE = 0.002  # share of the picture's pixels; smaller masks are left out
GREATEST_SHARE = 0.9  # larger masks are left out: a picture that is hidden almost whole has no content
CHANGED_REWARD = 0.05  # a label that differs by more counts as changed
BACKGROUND_WEIGHT = 0.5  # weight of the R_i of a background mask; that of an object is 1
_GROUND_PATCHES = 3  # number of patches: left, middle and right
_NEAREST_SHARE = 0.02  # share of an object's nearest pixels to ignore: measured depths have stray values


@dataclass(frozen=True)
class Mask:
    """Part of a picture to hide, and the truth of the scene without the object there, for R rays.

    Attributes:
        hidden: `(px, px)` bool, pixels to hide.
        background: whether these are ground, sky or far objects; the truth is then that of the whole scene.
        ray_distance_m: `(R,)` float32, true distance along each ray, capped at the camera's range.
        ray_dynamic: `(R,)` bool, whether the ray meets an object of a kind that moves.
    """

    hidden: np.ndarray
    background: bool
    ray_distance_m: np.ndarray
    ray_dynamic: np.ndarray


@dataclass(frozen=True)
class MaskedView:
    """One picture, its truth as in `Mask`, and at most `MOST_MASKS` masks.

    Attributes:
        image: `(px, px, 3)` uint8.
        ray_distance_m: `(R,)` float32, true distance along each ray, capped at the camera's range.
        ray_dynamic: `(R,)` bool, whether the ray meets an object of a kind that moves.
        masks: masks of this picture, each to be used alone.
        scene_hash: hash that groups the pictures of one scene, as in the views without masks.
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
        tokens: `(M, side, side, features)` float16, tokens of the masked pictures.
        image: `(M,)` int64, index of the original of each masked picture.
        ray_distance_m: `(M, R)` float32, distances without the hidden object; for background those of the original.
        ray_dynamic: `(M, R)` bool, whether a ray meets an object of a kind that moves, in the same scene.
        background: `(M,)` bool, whether the mask hides background.
    """

    tokens: np.ndarray
    image: np.ndarray
    ray_distance_m: np.ndarray
    ray_dynamic: np.ndarray
    background: np.ndarray

    def __len__(self) -> int:
        return len(self.tokens)


def hide(image: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Return the picture `(px, px, 3)` uint8 with the pixels `hidden` `(px, px)` in the mean colour of the others.

    A flat patch has no texture that an encoder could take for an object. The mean keeps the overall colour and
    brightness of the picture, which black does not; inpainting the background would need a model of its own.

    Raises:
        ValueError: the mask is not a `(px, px)` bool array, or hides the whole picture.
    """
    if hidden.shape != image.shape[:2] or hidden.dtype != np.bool_:
        raise ValueError(f"a mask is {hidden.shape} {hidden.dtype}; allowed for this picture is {image.shape[:2]} bool")
    if hidden.all():
        raise ValueError("a mask hides the whole picture; allowed is a mask that leaves at least one pixel")
    result = image.copy()
    result[hidden] = np.rint(image[~hidden].mean(0)).astype(np.uint8)
    return result


def choose_masks(
    instances: np.ndarray, distance_m: np.ndarray, ground: np.ndarray, sky: np.ndarray, range_m: float
) -> tuple[dict[int, np.ndarray], list[np.ndarray]]:
    """Return the masks of a picture, `(px, px)` bool each, none trivial and at most `MOST_MASKS` in all.

    Each object within the range has its own mask; if there are too many, the smallest are dropped. The background has
    one mask for all farther objects, one for the sky, and one each for the ground at the left, middle and right.

    Args:
        instances: `(px, px)` int, number of the object that each pixel shows; below 0: none.
        distance_m: `(px, px)` horizontal distance of the surface that each pixel shows; infinite if unknown.
        ground: `(px, px)` bool, ground that is drivable.
        sky: `(px, px)` bool, whether a pixel shows the sky.
        range_m: range of the camera, in metres.

    Returns:
        Masks of the objects by number, the largest first, and masks of the background.
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
    background = [hidden for hidden in (*patches, sky, far) if _is_usable(hidden)]
    usable = {number: hidden for number, hidden in objects.items() if _is_usable(hidden)}
    return dict(list(usable.items())[: MOST_MASKS - len(background)]), background


def rewards(
    ray_distance_m: np.ndarray,
    ray_dynamic: np.ndarray,
    ray_angles_rad: np.ndarray,
    progress: np.ndarray,
    goal_distance_m: np.ndarray,
) -> np.ndarray:
    """Return the reward labels R, or R_i of a masked scene, `(B, 3)`, from the truth of scenes and a goal each.

    Args:
        ray_distance_m: `(B, R)`, true distances along the rays.
        ray_dynamic: `(B, R)` bool, whether a ray meets an object of a kind that moves.
        ray_angles_rad: `(R,)`, angles of the rays, left positive.
        progress: `(B, 3)`, progress towards the goal in each direction, from `labels.progress`.
        goal_distance_m: `(B,)`, distances to the goals.
    """
    clearance_m, dynamic = nearest(ray_distance_m, ray_dynamic, ray_angles_rad)
    return reward_label(openness(clearance_m, dynamic, goal_distance_m[:, None]), progress)


def labels_changed(rewards_without: np.ndarray, rewards_with: np.ndarray) -> np.ndarray:
    """Return the actions for which a masked picture is a positive sample, `(..., 3)` bool; for others it is negative.

    Args:
        rewards_without: R_i `(..., 3)`, reward labels without the masked object.
        rewards_with: R `(..., 3)`, reward labels with it.
    """
    return np.abs(rewards_without - rewards_with) > CHANGED_REWARD


def pixel_distance_m(depth_m: np.ndarray, field_of_view_rad: float) -> np.ndarray:
    """Return the horizontal distance `(px, px)` of each pixel of a level camera from its depth along the axis."""
    px = depth_m.shape[1]
    slope = np.tan(field_of_view_rad / 2) * (1 - 2 * (np.arange(px) + 0.5) / px)
    return depth_m * np.sqrt(1 + slope**2)


def _is_usable(hidden: np.ndarray) -> bool:
    return TRIVIAL_SHARE <= hidden.mean() <= GREATEST_SHARE
