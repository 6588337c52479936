"""The artificial potential field over believed space, and the action that follows its direction best."""

import math

import numpy as np

from zsdist.planning.footprint import TURNS
from zsdist.types import Action

BODY_M = 0.645  # half the car's width and a margin, subtracted from distances to the car's centre
NEAREST_M = 0.05  # least distance to an obstacle: the repulsion has a pole at 0
IN_PLACE = 0.15  # penalty of a turn in place, as a cosine: it must point this much better than an advance
_TURN_OF = tuple(zip(Action, TURNS, strict=True))


def attraction(distance_m: float, k_att: float) -> float:
    """Return the potential U_att, which grows with the square of the distance to the goal. Eq. (14)."""
    return 0.5 * k_att * distance_m**2


def repulsion(distance_m: float, k_rep: float, influence_m: float) -> float:
    """Return the potential U_rep of the nearest obstacle, 0 beyond its influence distance. Eq. (15)."""
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
    """Return the force on the car, `(2,)`. Eq. (16): F = -grad U, U the sum of attraction and repulsion.

    Deviation: by default the attraction is conic, which means of constant size. A quadratic one outweighs every
    obstacle far from the goal. The distance to an obstacle is measured from the car's body. Positions that the car has
    visited repel it by `k_trail`, since otherwise it stays in the first local minimum. `conic=False, k_trail=0` is the
    paper's field, except that distances are measured from the body.

    Args:
        position: centre of the car `(x_m, y_m)`.
        target: point `(x_m, y_m)` that attracts.
        obstacles: `(N, 2)` points of believed surfaces, metres.
        k_att: constant of the attraction.
        k_rep: constant of the repulsion.
        influence_m: distance within which obstacles and the trail repel.
        conic: whether the attraction has constant size.
        trail: `(M, 2)` visited positions, metres, each repeated as often as it was visited.
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


def action_along(
    direction: np.ndarray, heading_rad: float, mask: np.ndarray, reluctance: np.ndarray | None = None
) -> Action | None:
    """Return the allowed action after which the car points best along `direction`; None if no action is allowed.

    Args:
        direction: `(2,)` of any length.
        heading_rad: heading of the car.
        mask: `(5,)` bool, allowed actions.
        reluctance: `(5,)` penalty of each action, as a cosine, such as for visits to the state in which it ends.
    """
    bearing = math.atan2(direction[1], direction[0]) - heading_rad
    penalties: list[float] = [0.0] * len(_TURN_OF) if reluctance is None else reluctance.tolist()
    best_score, best_action = -math.inf, None
    for (action, eighths), allowed in zip(_TURN_OF, mask.tolist(), strict=True):
        score = math.cos(bearing - eighths * math.pi / 4) - IN_PLACE * (abs(eighths) == 2) - penalties[action]
        if allowed and score > best_score:
            best_score, best_action = score, action
    return best_action
