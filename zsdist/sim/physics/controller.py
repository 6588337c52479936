"""Controller that turns one lattice action into wheel rates for each step of the simulation."""

import math
from typing import NamedTuple

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.types import Pose

WHEEL_RADIUS_M = 0.5  # Table 1


class Motion(NamedTuple):
    """Pose and motion of the car: `speed_mps` along its heading, `turn_rate_rad_s` counter-clockwise."""

    pose: Pose
    speed_mps: float
    turn_rate_rad_s: float


class Rates(NamedTuple):
    """Wheel rates in radians per second, forward positive; both wheels of a side have the same rate."""

    left: float
    right: float


STOPPED = Rates(0.0, 0.0)


class Gains(NamedTuple):
    """Constants of the controller; the defaults come from a random search over driven sequences."""

    turn: float = 16.0  # wheel rate (rad/s) per radian of heading error, in place
    turn_most_rad_s: float = 11.0
    turn_least_rad_s: float = 2.5  # friction holds the wheels at lower rates
    aligned_rad: float = 0.07  # a turn in place ends at this heading error
    calm_rad_s: float = 0.45  # and at a turn rate this low
    facing_rad: float = 0.27  # an advance begins at this heading error
    hold: float = 4.5  # speed (1/s) per metre off the target while turning in place
    hold_most_mps: float = 0.3
    still_mps: float = 0.1  # a turn begins at this speed: at higher speeds the car slides away
    speed_most_mps: float = 1.75
    speed_up_mps2: float = 5.0
    slow_down_mps2: float = 4.0
    arrive_m: float = 0.1  # an advance ends this close to the target: about the distance that it takes to stop
    arrive_mps: float = 1.2  # and at a speed this low
    flow_mps: float = 1.0  # speed demanded at the target, so that a following advance need not start from rest
    look_ahead_m: float = 0.8  # least distance over which a lateral offset is corrected
    aim_most_rad: float = 0.17
    steer: float = 9.3  # wheel rate (rad/s) per radian of heading error, driving
    damp: float = 0.5  # wheel rate per turn rate


GAINS = Gains()


# Phases of a manoeuvre.
_BRAKE = 1
_TURN = 2  # in place, towards the line to the target
_ADVANCE = 3
_ALIGN = 4  # in place, to the target's heading
_DONE = 5

_X, _Y, _HEADING, _ADVANCES, _STEP_S, _PHASE, _DEMANDED_MPS = range(7)  # indices of a manoeuvre's state


class Manoeuvre:
    """Control of the car until it reaches one target pose: brake, turn in place, advance along the heading, align.

    An advance ends while the car still rolls, so near the target that it comes to rest there.

    Args:
        target: pose in which the manoeuvre ends.
        advance: whether the car advances; False for a turn in place.
        turn: whether a turn comes first; without one the car keeps its speed from the previous manoeuvre.
        step_s: seconds between two calls of `steer`.

    Attributes:
        target: pose in which the manoeuvre ends.
        state: `(7,)` float64, state that `steer` reads and writes: the target's x, y and heading, whether the car
            advances, the seconds between two calls, the phase, and the last demanded speed (NaN: none yet).
    """

    def __init__(self, target: Pose, advance: bool, turn: bool, step_s: float) -> None:
        self.target = target
        phase = _BRAKE if turn or not advance else _ADVANCE
        self.state = np.array([*target, advance, step_s, phase, math.nan])

    def rates(self, motion: Motion) -> Rates | None:
        """Return the wheel rates for the next step; None once the car has arrived."""
        rates = Rates(*steer(self.state, *motion.pose, motion.speed_mps, motion.turn_rate_rad_s))
        return None if math.isnan(rates.left) else rates


@compiled()
def steer(
    state: np.ndarray, x_m: float, y_m: float, heading: float, speed_mps: float, turn_rate: float
) -> tuple[float, float]:
    """Return the rates of the left and right wheels for the next step of a manoeuvre; NaN once the car has arrived.

    Args:
        state: state of the `Manoeuvre`; written in place.
        x_m: x of the car's centre.
        y_m: y of the car's centre.
        heading: heading of the car in radians, within half a turn of east.
        speed_mps: speed of the car along its heading.
        turn_rate: turn rate of the car, in radians per second.
    """
    phase, advances = int(state[_PHASE]), state[_ADVANCES] != 0.0
    east, north = state[_X] - x_m, state[_Y] - y_m
    turn = state[_HEADING] - heading
    if abs(turn) > math.pi:
        turn -= math.copysign(math.tau, turn)
    cos, sin = math.cos(state[_HEADING]), math.sin(state[_HEADING])
    ahead, aside = east * cos + north * sin, north * cos - east * sin
    aim = turn + _clip(aside / max(ahead, GAINS.look_ahead_m), GAINS.aim_most_rad)
    if phase == _BRAKE:
        if speed_mps > GAINS.still_mps:
            return 0.0, 0.0
        phase = _TURN if advances else _ALIGN
    if phase == _TURN and abs(aim) < GAINS.facing_rad:
        phase = _ADVANCE
    if phase == _ADVANCE and ahead < GAINS.arrive_m and speed_mps < GAINS.arrive_mps:
        phase = _ALIGN
    state[_PHASE] = phase
    if phase == _ADVANCE:
        before = speed_mps if math.isnan(state[_DEMANDED_MPS]) else state[_DEMANDED_MPS]
        braking = math.sqrt(2 * GAINS.slow_down_mps2 * ahead + GAINS.flow_mps**2) if ahead > 0 else 0.0
        demanded_mps = max(0.0, min(GAINS.speed_most_mps, braking, before + GAINS.speed_up_mps2 * state[_STEP_S]))
        state[_DEMANDED_MPS] = demanded_mps
        rate = _clip(GAINS.steer * aim - GAINS.damp * turn_rate, GAINS.turn_most_rad_s)
        return demanded_mps / WHEEL_RADIUS_M - rate, demanded_mps / WHEEL_RADIUS_M + rate
    error, hold_mps = aim, 0.0
    if phase == _ALIGN:
        if abs(turn) < GAINS.aligned_rad:
            if abs(turn_rate) >= GAINS.calm_rad_s:
                return 0.0, 0.0
            state[_PHASE] = _DONE
            return math.nan, math.nan
        off = east * math.cos(heading) + north * math.sin(heading)
        error, hold_mps = turn, _clip(GAINS.hold * off, GAINS.hold_most_mps)
    size = min(max(GAINS.turn * abs(error), GAINS.turn_least_rad_s), GAINS.turn_most_rad_s)
    rate = math.copysign(size, error)
    return hold_mps / WHEEL_RADIUS_M - rate, hold_mps / WHEEL_RADIUS_M + rate


@compiled()
def _clip(value: float, most: float) -> float:
    return max(-most, min(most, value))
