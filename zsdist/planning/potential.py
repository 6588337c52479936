"""The artificial potential field over believed space, and how its direction becomes an action."""

import math

import numpy as np

from zsdist.types import Action

BODY_M = 0.645  # half the car's width and a margin: what is left of a distance to the centre is room
NEAREST_M = 0.05  # the repulsion has a pole at touch
IN_PLACE = 0.15  # a turn in place must point this much better, in cosines, than moving on
TURN_EIGHTHS = {
    Action.FORWARD: 0,
    Action.LEFT_45: 1,
    Action.RIGHT_45: -1,
    Action.TURN_LEFT_90: 2,
    Action.TURN_RIGHT_90: -2,
}


def attraction(distance_m: float, k_att: float) -> float:
    """U_att, which grows with the square of the distance to the goal. Eq. (14)."""
    return 0.5 * k_att * distance_m**2


def repulsion(distance_m: float, k_rep: float, influence_m: float) -> float:
    """U_rep of the nearest obstacle at `distance_m`, none beyond its influence distance. Eq. (15)."""
    if distance_m > influence_m:
        return 0.0
    return 0.5 * k_rep * (1.0 / distance_m - 1.0 / influence_m) ** 2


def force(
    position: tuple[float, float],
    target: tuple[float, float],
    obstacles: np.ndarray,
    *,
    k_att: float,
    k_rep: float,
    influence_m: float,
    conic: bool = True,
    trail: np.ndarray | None = None,
    k_trail: float = 0.0,
) -> np.ndarray:
    """The direction in which the potential falls, `(2,)`. Eq. (16): F = -grad U, U the sum of attraction and repulsion.

    Deviation: by default the attraction is conic (constant in size, the usual cure for one that drowns every obstacle
    far from the goal); the distance to an obstacle is what is left beside the car's body; and places where the car
    has been repel it by `k_trail`, without which it stays in the first local minimum. `conic=False, k_trail=0` is the
    paper's field.

    Args:
        position: the car's centre.
        target: what attracts.
        obstacles: `(N, 2)` points of believed surfaces.
        k_att: constant of the attraction.
        k_rep: constant of the repulsion.
        influence_m: distance from which obstacles repel.
        conic: attraction of constant size.
        trail: `(M, 2)` places where the car has been, repeated as often as it was there.
        k_trail: constant of the trail's repulsion.
    """
    here = np.asarray(position, np.float64)
    to_target = np.asarray(target, np.float64) - here
    distance = math.hypot(*to_target)
    total = k_att * to_target / (max(distance, 1e-9) if conic else 1.0)
    if len(obstacles):
        away = here - obstacles
        distances = np.hypot(away[:, 0], away[:, 1])
        nearest = int(distances.argmin())
        room = max(distances[nearest] - BODY_M, NEAREST_M)
        if room <= influence_m:
            slope = k_rep * (1.0 / room - 1.0 / influence_m) / room**2
            total = total + slope * away[nearest] / max(distances[nearest], 1e-9)
    if trail is not None and k_trail and len(trail):
        away = here - trail
        distances = np.hypot(away[:, 0], away[:, 1])
        near = (distances < influence_m) & (distances > 1e-6)
        weight = k_trail * (1.0 - distances[near] / influence_m)
        total = total + (weight[:, None] * away[near] / distances[near][:, None]).sum(0)
    return total


def decompose(
    direction: np.ndarray, heading_rad: float, mask: np.ndarray, reluctance: np.ndarray | None = None
) -> Action | None:
    """The allowed action after which the car points best along `direction`; None where nothing is allowed.

    Args:
        direction: `(2,)` of any length.
        heading_rad: the car's.
        mask: `(5,)` bool, allowed actions.
        reluctance: `(5,)` what speaks against each action, in cosines (such as having been at its end before).
    """
    bearing = math.atan2(direction[1], direction[0]) - heading_rad
    against = [0.0] * len(TURN_EIGHTHS) if reluctance is None else reluctance.tolist()
    best, choice = -math.inf, None
    for (action, eighths), allowed in zip(TURN_EIGHTHS.items(), mask.tolist(), strict=True):
        score = math.cos(bearing - eighths * math.pi / 4) - IN_PLACE * (abs(eighths) == 2) - against[action]
        if allowed and score > best:
            best, choice = score, action
    return choice
