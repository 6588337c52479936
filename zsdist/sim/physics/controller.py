"""The controller that turns one lattice action into four wheel rates, a step of the simulation at a time."""

import math
from typing import NamedTuple

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.types import Pose

WHEEL_RADIUS_M = 0.5  # Table 1


class Motion(NamedTuple):
    """Where the car is and how it moves: `speed_mps` along its heading, `turn_rate_rad_s` counter-clockwise."""

    pose: Pose
    speed_mps: float
    turn_rate_rad_s: float


class Rates(NamedTuple):
    """Wheel rates in radians a second, forward positive; both wheels of a side turn alike."""

    left: float
    right: float


STOPPED = Rates(0.0, 0.0)


class Gains(NamedTuple):
    """The controller's constants; the defaults were found by a random search over driven sequences."""

    turn: float = 16.0  # wheel rate (rad/s) per radian of heading error, in place
    turn_most_rad_s: float = 11.0
    turn_least_rad_s: float = 2.5  # below this the wheels only strain against friction
    aligned_rad: float = 0.07  # a heading this close ends a turn in place
    calm_rad_s: float = 0.45  # and so slow a turn
    facing_rad: float = 0.27  # a heading this close lets the advance begin
    hold: float = 4.5  # speed (1/s) per metre off the place, turning in place
    hold_most_mps: float = 0.3
    still_mps: float = 0.1  # a turn begins once the car is this slow: turning at speed, it slides off its place
    speed_most_mps: float = 1.75
    speed_up_mps2: float = 5.0
    slow_down_mps2: float = 4.0
    arrive_m: float = 0.1  # so close ahead of the target the advance ends: about the way it takes to stop
    arrive_mps: float = 1.2  # if the car is this slow
    flow_mps: float = 1.0  # speed asked for at the target, so that an advance that follows need not start from rest
    look_ahead_m: float = 0.8  # least distance over which an offset to the side is taken out
    aim_most_rad: float = 0.17
    steer: float = 9.3  # wheel rate (rad/s) per radian of heading error, driving
    damp: float = 0.5  # wheel rate per turn rate


GAINS = Gains()


# What a manoeuvre is at.
_BRAKE = 1
_TURN = 2  # in place, towards the line to the target
_ADVANCE = 3
_ALIGN = 4  # in place, to the target's heading
_THERE = 5

_X, _Y, _HEADING, _ADVANCES, _STEP_S, _PHASE, _ASKED_MPS = range(7)  # of a manoeuvre's state


class Manoeuvre:
    """Drives the car to one target pose: brake and turn in place first, then advance along its heading, then align.

    An advance ends while the car still rolls, so near the target that it would come to rest there.

    Args:
        target: pose to end at.
        advance: False for a turn in place.
        turn: whether a turn comes first; without one a speed from the manoeuvre before is kept.
        step_s: time between two calls of `steer`.

    Attributes:
        target: as given.
        state: `(7,)` float64, which `steer` reads and writes: the target's x, y and heading, whether it advances, the
            time between two calls, what it is at, and the speed asked for last (NaN: none yet).
    """

    def __init__(self, target: Pose, advance: bool, turn: bool, step_s: float) -> None:
        self.target = target
        phase = _BRAKE if turn or not advance else _ADVANCE
        self.state = np.array([*target, advance, step_s, phase, math.nan])

    def rates(self, motion: Motion) -> Rates | None:
        """The wheel rates for the next step; None once the car is there."""
        rates = Rates(*steer(self.state, *motion.pose, motion.speed_mps, motion.turn_rate_rad_s))
        return None if math.isnan(rates.left) else rates


@compiled()
def steer(
    state: np.ndarray, x_m: float, y_m: float, heading: float, speed_mps: float, turn_rate: float
) -> tuple[float, float]:
    """Rates of the left and the right wheels for the next step of a manoeuvre; NaN once the car is there.

    Args:
        state: of the `Manoeuvre`.
        x_m: place of the car.
        y_m: place of the car.
        heading: of the car, radians within half a turn of east.
        speed_mps: of the car.
        turn_rate: of the car, radians a second.
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
        before = speed_mps if math.isnan(state[_ASKED_MPS]) else state[_ASKED_MPS]
        braking = math.sqrt(2 * GAINS.slow_down_mps2 * ahead + GAINS.flow_mps**2) if ahead > 0 else 0.0
        asked_mps = max(0.0, min(GAINS.speed_most_mps, braking, before + GAINS.speed_up_mps2 * state[_STEP_S]))
        state[_ASKED_MPS] = asked_mps
        rate = _clip(GAINS.steer * aim - GAINS.damp * turn_rate, GAINS.turn_most_rad_s)
        return asked_mps / WHEEL_RADIUS_M - rate, asked_mps / WHEEL_RADIUS_M + rate
    error, hold_mps = aim, 0.0
    if phase == _ALIGN:
        if abs(turn) < GAINS.aligned_rad:
            if abs(turn_rate) >= GAINS.calm_rad_s:
                return 0.0, 0.0
            state[_PHASE] = _THERE
            return math.nan, math.nan
        off = east * math.cos(heading) + north * math.sin(heading)
        error, hold_mps = turn, _clip(GAINS.hold * off, GAINS.hold_most_mps)
    size = min(max(GAINS.turn * abs(error), GAINS.turn_least_rad_s), GAINS.turn_most_rad_s)
    rate = math.copysign(size, error)
    return hold_mps / WHEEL_RADIUS_M - rate, hold_mps / WHEEL_RADIUS_M + rate


@compiled()
def _clip(value: float, most: float) -> float:
    return max(-most, min(most, value))
