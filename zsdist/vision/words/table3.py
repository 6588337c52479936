"""Table 3 of the paper: similarity of the attended embeddings to words of obstacles and grounds.

I_0 is the embedding of the whole picture; I_1 to I_3 are those of the parts that the actions forward, left and right
attend to. The paper shows one row for each object and speaks of a tree in front. So an object's row is the mean over
pictures that have it in front and in no other direction, and I_1 should be its highest. A ground's row is the mean over
all pictures on that ground, including those with an empty direction, and I_0 should be its highest.
"""

import numpy as np

from zsdist.vision.encoders.base import similarity
from zsdist.vision.labels import sectors

COLUMNS = ("I_0", "I_1", "I_2", "I_3")
FRONT = 0


def directions_of(
    segment: int, ray_segment: np.ndarray, ray_distance_m: np.ndarray, ray_angles_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions in which a kind of obstacle is nearest, and those in which it is present.

    A kind is nearest in a direction if the nearest hit of the direction's rays is of that kind; that hit decides the
    reward label of the action. It is present if one ray or more meets an obstacle of the kind.

    Args:
        segment: number of the kind in segmentation images.
        ray_segment: `(N, R)`, segment number of the obstacle that each ray meets within the camera's range.
        ray_distance_m: `(N, R)`, true distances along the rays.
        ray_angles_rad: `(R,)`, angles of the rays, left positive.

    Returns:
        Both `(N, 3)` bool.
    """
    nearest, present = [], []
    for sector in sectors(ray_angles_rad):
        kinds, distance = ray_segment[:, sector], ray_distance_m[:, sector]
        first = np.take_along_axis(kinds, distance.argmin(1)[:, None], 1)[:, 0]
        nearest.append(first == segment)
        present.append((kinds == segment).any(1))
    return np.stack(nearest, 1), np.stack(present, 1)


def only_direction(nearest: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Return the only direction in which a kind is present, `(N,)`, if it is nearest there; -1 otherwise."""
    one = nearest.any(1) & (present.sum(1) == 1)
    return np.where(one, present.argmax(1), -1)


def similarities(embeddings: np.ndarray, word: np.ndarray) -> np.ndarray:
    """Return cosines `(N, 4)` of I_0 to I_3 `(N, 4, D)` with the embedding of a word `(D,)`."""
    return similarity(embeddings.reshape(-1, len(word)), word[None]).reshape(embeddings.shape[:2])


def table3(
    embeddings: np.ndarray,
    words: dict[str, np.ndarray],
    directions: dict[str, np.ndarray],
    grounds: dict[str, np.ndarray],
) -> dict[str, dict[str, float]]:
    """Return the rows of Table 3: mean similarities under the keys I_0 to I_3, and the number of pictures.

    Args:
        embeddings: `(N, 4, D)`, I_0 to I_3.
        words: embedding `(D,)` of each row's word, by name.
        directions: direction `(N,)` of each kind of object, from `only_direction`.
        grounds: `(N,)` bool for each ground, whether the picture is taken on it.

    Returns:
        A row for each object and ground that has pictures.
    """
    chosen = {name: where == FRONT for name, where in directions.items()} | grounds
    rows = {}
    for name, pictures in chosen.items():
        if pictures.any():
            means = similarities(embeddings[pictures], words[name]).mean(0)
            rows[name] = dict(zip(COLUMNS, means.tolist(), strict=True)) | {"images": int(pictures.sum())}
    return rows


def object_share(embeddings: np.ndarray, word: np.ndarray, direction: np.ndarray) -> float:
    """Return the share of pictures in which I_a is nearest to the word of the object in direction a; NaN without any.

    I_a is compared with the other two of I_1 to I_3.

    Args:
        embeddings: `(N, 4, D)`, I_0 to I_3.
        word: `(D,)`, embedding of the object's word.
        direction: `(N,)`, direction a from `only_direction`; -1: the picture does not count.
    """
    counted = direction >= 0
    if not counted.any():
        return float("nan")
    nearest = similarities(embeddings[counted], word)[:, 1:].argmax(1)
    return float(np.mean(nearest == direction[counted]))


def background_share(embeddings: np.ndarray, word: np.ndarray, pictures: np.ndarray) -> float:
    """Return the share of `pictures` `(N,)` bool whose word is nearer to I_0 than to I_1, I_2 and I_3; NaN if none."""
    if not pictures.any():
        return float("nan")
    found = similarities(embeddings[pictures], word)
    return float(np.mean((found[:, 1:] < found[:, :1]).all(1)))
