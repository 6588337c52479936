"""Table 3 of the paper: how near the attended embeddings come to the words of what is, and is not, in the way.

I_0 is the embedding of the whole picture, I_1 to I_3 what the actions forward, left and right looked at. The paper
shows one row for each object and speaks of a tree in front; so a row of an object is the mean over pictures that have
it in front and in no other direction, and its highest number should be that of I_1. A row of a ground is the mean over
pictures on that ground, whatever stands there, also where a direction is empty; I_0 should be its highest.
"""

import numpy as np

from zsdist.vision.encoders.base import similarity
from zsdist.vision.labels import sectors

COLUMNS = ("I_0", "I_1", "I_2", "I_3")
FRONT = 0


def directions_of(
    segment: int, ray_segment: np.ndarray, ray_distance_m: np.ndarray, ray_angles_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where a kind of obstacle is what matters, and where there is any of it, both `(N, 3)` bool.

    It is what matters in a direction where the nearest thing of that direction's rays is one of the kind, by which
    the reward label of the action goes; there is any of it where one ray or more meets one.

    Args:
        segment: the kind's number in segmentation images.
        ray_segment: `(N, R)`, the number of what each ray meets within the camera's range.
        ray_distance_m: `(N, R)`.
        ray_angles_rad: `(R,)`.
    """
    nearest, any_of_it = [], []
    for sector in sectors(ray_angles_rad):
        kinds, distance = ray_segment[:, sector], ray_distance_m[:, sector]
        first = np.take_along_axis(kinds, distance.argmin(1)[:, None], 1)[:, 0]
        nearest.append(first == segment)
        any_of_it.append((kinds == segment).any(1))
    return np.stack(nearest, 1), np.stack(any_of_it, 1)


def only_direction(nearest: np.ndarray, any_of_it: np.ndarray) -> np.ndarray:
    """The one direction `(N,)` in which a kind is what matters, and which alone has any of it; else -1."""
    one = nearest.any(1) & (any_of_it.sum(1) == 1)
    return np.where(one, any_of_it.argmax(1), -1)


def similarities(embeddings: np.ndarray, word: np.ndarray) -> np.ndarray:
    """Cosines `(N, 4)` of I_0 to I_3 `(N, 4, D)` with the embedding of a word `(D,)`."""
    return similarity(embeddings.reshape(-1, len(word)), word[None]).reshape(embeddings.shape[:2])


def table3(
    embeddings: np.ndarray,
    words: dict[str, np.ndarray],
    directions: dict[str, np.ndarray],
    grounds: dict[str, np.ndarray],
) -> dict[str, dict[str, float]]:
    """Mean similarities of the rows of Table 3, under the keys I_0 to I_3, and the number of pictures of each.

    Args:
        embeddings: `(N, 4, D)`, I_0 to I_3.
        words: of every row `(D,)`.
        directions: for each kind of object the direction `(N,)` that `only_direction` tells.
        grounds: for each ground `(N,)` bool, whether the picture is taken on it.

    Returns:
        A row for each object and ground that is in a picture; one that is in none has no row.
    """
    chosen = {name: where == FRONT for name, where in directions.items()} | grounds
    rows = {}
    for name, pictures in chosen.items():
        if pictures.any():
            means = similarities(embeddings[pictures], words[name]).mean(0)
            rows[name] = dict(zip(COLUMNS, means.tolist(), strict=True)) | {"images": int(pictures.sum())}
    return rows


def object_share(embeddings: np.ndarray, word: np.ndarray, direction: np.ndarray) -> float:
    """P(I_a is nearer to the word of the object in direction a than the other two are); NaN with no such picture.

    Args:
        embeddings: `(N, 4, D)`.
        word: `(D,)`.
        direction: `(N,)` a, as of `only_direction`; -1: the picture does not count.
    """
    counted = direction >= 0
    if not counted.any():
        return float("nan")
    nearest = similarities(embeddings[counted], word)[:, 1:].argmax(1)
    return float(np.mean(nearest == direction[counted]))


def background_share(embeddings: np.ndarray, word: np.ndarray, pictures: np.ndarray) -> float:
    """Share of `pictures` `(N,)` bool in which the word is less near to each of I_1 to I_3 than to I_0; NaN if none."""
    if not pictures.any():
        return float("nan")
    found = similarities(embeddings[pictures], word)
    return float(np.mean((found[:, 1:] < found[:, :1]).all(1)))
