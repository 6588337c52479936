"""Distance along camera rays as a distribution over bins: angles, edges, labels and quantiles.

A distance is horizontal, from the camera to the nearest surface below the height of the car. It falls into one of
`BINS - 1` bins of equal width in the logarithm of the distance, or into the last bin, "free": nothing within `RANGE_M`.
"""

import numpy as np

RAYS = 32
BINS = 25
NEAREST_M = 0.25  # smaller distances count in the first bin
RANGE_M = 5.0
BIN_EDGES_M = np.geomspace(NEAREST_M, RANGE_M, BINS).astype(np.float32)
"""`(BINS,)` edges of the first `BINS - 1` bins."""

BIN_CENTRES_M = np.append(np.sqrt(BIN_EDGES_M[:-1] * BIN_EDGES_M[1:]), RANGE_M).astype(np.float32)
"""`(BINS,)` the distance that each bin represents; for "free" it is the range."""

_LABEL_WIDTH_BINS = 0.7  # a little wider than a bin, so that the next bin counts as nearly right


def ray_angles_rad(rays: int, field_of_view_rad: float) -> np.ndarray:
    """Return the angles of equal pixel columns from the camera's axis, `(rays,)` float32, left positive and first."""
    columns = 1 - 2 * (np.arange(rays) + 0.5) / rays
    return np.arctan(np.tan(field_of_view_rad / 2) * columns).astype(np.float32)


def soft_labels(distance_m: np.ndarray) -> np.ndarray:
    """Return target distributions `(..., BINS)` float32 of the training for true distances `(...)` in metres.

    A label is a normal curve around the distance in units of bins; from `RANGE_M` on all mass is on "free".
    """
    distance_m = np.asarray(distance_m, np.float64)
    step = np.log(RANGE_M / NEAREST_M) / (BINS - 1)
    position = np.log(np.clip(distance_m, NEAREST_M, RANGE_M) / NEAREST_M) / step - 0.5
    labels = np.zeros((*distance_m.shape, BINS))
    labels[..., :-1] = np.exp(-0.5 * ((np.arange(BINS - 1) - position[..., None]) / _LABEL_WIDTH_BINS) ** 2)
    free = distance_m >= RANGE_M
    labels[free] = 0.0
    labels[free, -1] = 1.0
    return (labels / labels.sum(-1, keepdims=True)).astype(np.float32)


def exact_labels(distance_m: np.ndarray) -> np.ndarray:
    """Return target distributions `(..., BINS)` float32 with all mass on the bin of each true distance in metres.

    They need more pictures than `soft_labels`. A network trained on them keeps its quantiles calibrated where it is
    sure, since no label is wider than its bin.
    """
    distance_m = np.asarray(distance_m, np.float32)
    return np.eye(BINS, dtype=np.float32)[np.searchsorted(BIN_EDGES_M[1:], distance_m, side="right")]


def quantile_m(probabilities: np.ndarray, share: float) -> np.ndarray:
    """Return the quantile `(...)` in metres at `share` of each distribution `(..., BINS)`.

    Within a bin the mass is spread evenly; in "free" the quantile is `RANGE_M`. A low share is a cautious estimate.

    Raises:
        ValueError: `share` is not inside (0, 1).
    """
    if not 0 < share < 1:
        raise ValueError(f"the share of a quantile is {share}; allowed is between 0 and 1, exclusive")
    below = np.cumsum(probabilities, axis=-1)
    index = np.minimum((below < share).sum(-1), BINS - 1)
    mass = np.take_along_axis(probabilities, index[..., None], -1)[..., 0]
    before = np.take_along_axis(below, index[..., None], -1)[..., 0] - mass
    part = np.clip((share - before) / np.maximum(mass, 1e-9), 0.0, 1.0)
    upper = np.append(BIN_EDGES_M[1:], RANGE_M)
    return (BIN_EDGES_M[index] + part * (upper - BIN_EDGES_M)[index]).astype(np.float32)
