"""Record of a driven episode."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from zsdist.types import Outcome, Pose


@dataclass(frozen=True)
class EpisodeRecord:
    """One driven episode.

    Attributes:
        scene: name of the scene.
        outcome: outcome of the episode.
        steps: number of actions taken.
        fewest_steps: fewest actions that reach the goal from the start; None where the planner knows no path.
        path_m: length of the driven path.
        shortest_m: length of the shortest drivable path; None where the planner knows no path.
        remaining_m: length of the shortest drivable path from the last pose that had one; None where no pose had one.
        min_clearance_m: least distance of the car's box from an obstacle's surface or a wall; 0 in contact.
        static: whether nothing in the scene moves.
        decision_ms: `(steps,)`, time of each decision, vision included.
        shield_changes: number of decisions that the shield changed.
        poses: the driven path, start included.
    """

    scene: str
    outcome: Outcome
    steps: int
    fewest_steps: int | None
    path_m: float
    shortest_m: float | None
    remaining_m: float | None
    min_clearance_m: float
    static: bool
    decision_ms: tuple[float, ...]
    shield_changes: int
    poses: tuple[Pose, ...]


def path_length_m(poses: Sequence[Pose]) -> float:
    """Return the length in metres of the polyline through the poses' positions."""
    return sum(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in pairwise(poses))
