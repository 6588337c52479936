"""What runs of any size need, from the points of `_crowd.py`: CPU time of a part is a sum of costs of what it does.

Costs are fitted by least squares without negative ones, so that no part becomes cheaper by doing more. A part that
works on one thread, as a shard does, breaks where it would need more than `FULL` of a core; the hub uses several.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import nnls

FULL = 0.8  # of a core, above which delays grow
COSTS = {  # of a second of CPU time each
    "hub": ("pushes_per_s", "push_bytes_per_s", "acks_per_s", "weights_per_s", "clients"),
    "shard": ("transitions_per_s", "pushes_per_s", "acks_per_s"),
    "client": ("pushes_per_s", "acks_per_s", "weights_per_s", "clients"),
}
Point = dict[str, Any]


def fit(points: Sequence[Point], part: str) -> dict[str, float]:
    """Return the CPU seconds that each cost of a part takes, and `error`, the root mean square of relative errors.

    Raises:
        ValueError: there are fewer points than costs that vary.
    """
    names = COSTS[part]
    rows = np.array([[float(point[name]) for name in names] for point in points])
    spent = np.array([float(point[f"{part}_cores"]) for point in points])
    scale = np.maximum(rows.max(axis=0), 1e-9)
    if len(points) < 2:
        raise ValueError(f"{len(points)} points; allowed are 2 or more")
    found, _ = nnls(rows / scale / spent[:, None], np.ones(len(points)))
    predicted = rows / scale @ found
    error = float(np.sqrt(np.mean((predicted / spent - 1) ** 2)))
    return {**{name: float(value) for name, value in zip(names, found / scale, strict=True)}, "error": error}


def demand(clients: int, rate: float, points: Sequence[Point], weights_per_s: float) -> Point:
    """Return the rates of a run of so many actors, in proportion to those of the largest point."""
    largest = max(points, key=lambda point: point["transitions_per_s"])
    transitions = clients * rate
    share = transitions / largest["transitions_per_s"]
    names = ("pushes_per_s", "push_bytes_per_s", "acks_per_s")
    scaled = {name: largest[name] * share for name in names}
    return {**scaled, "clients": clients, "transitions_per_s": transitions, "weights_per_s": clients * weights_per_s}


def needs(
    points: Sequence[Point], clients: int, rate: float, weights_per_s: float, weights_bytes: int
) -> dict[str, float]:
    """Return the cores, shards and bytes per second that a run of so many actors needs."""
    wanted = demand(clients, rate, points, weights_per_s)
    cores = {}
    for part in ("hub", "shard"):
        costs = fit(points, part)
        cores[part] = sum(costs[name] * wanted[name] for name in COSTS[part])
    return {
        "hub_cores": cores["hub"],
        "shards": float(np.ceil(cores["shard"] / FULL)),
        "hub_megabytes_per_s": (wanted["push_bytes_per_s"] + wanted["weights_per_s"] * weights_bytes) / 1e6,
        "transitions_per_s": wanted["transitions_per_s"],
    }
