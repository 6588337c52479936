import json
import math
from pathlib import Path

import numpy as np
import pytest

from zsdist.agent import features
from zsdist.agent.blocks import GOAL_CHOICE, HIGH_ACTIONS, choices
from zsdist.agent.reward_shaping import path_costs
from zsdist.agent.situation import Situation, Tries
from zsdist.planning import forward_search
from zsdist.planning.footprint import FootprintTable
from zsdist.planning.grid import Grid
from zsdist.planning.reachability import BlockedMoves
from zsdist.planning.shortest_path import goal_mask
from zsdist.types import LatticeState, Level

GRID = Grid()
TABLE = FootprintTable(GRID)
CELLS, FINE = GRID.cells, GRID.fine_size
FEATURES = json.loads((Path(__file__).parents[2] / "data" / "features.json").read_text())


def world(seed):
    """Return a random believed world with a car in it, as the parts of a `Situation`."""
    rng = np.random.default_rng(seed)
    occupied = np.zeros((FINE, FINE), bool)
    for _ in range(14):
        x, y = rng.integers(10, FINE - 16, 2)
        occupied[y : y + rng.integers(2, 10), x : x + rng.integers(2, 10)] = True
    state = LatticeState(int(rng.integers(4, 28)), int(rng.integers(4, 28)), int(rng.integers(8)))
    fx, fy = GRID.fine_index(*GRID.centre(state.ix, state.iy))
    occupied[fy - 10 : fy + 10, fx - 10 : fx + 10] = False
    goal = tuple(float(value) for value in rng.uniform(-9.5, 9.5, 2))
    return {
        "state": state,
        "goal": goal,
        "advice": rng.normal(size=3).astype(np.float32),
        "occupied": occupied,
        "seen": rng.random((FINE, FINE)) < 0.7,
        "visits": rng.integers(0, 2, (CELLS, CELLS, 8)).astype(np.int32),
        "block_visits": rng.integers(0, 4, (4, 4)).astype(np.int32),
        "tries": Tries(rng.integers(0, 4, (4, 4)).astype(np.int32), int(rng.integers(3))),
    }


def reflected(parts):
    """Return the same world with north and south exchanged."""
    state = parts["state"]
    turned = (-np.arange(8)) % 8
    return parts | {
        "state": LatticeState(state.ix, CELLS - 1 - state.iy, -state.heading % 8),
        "goal": (parts["goal"][0], -parts["goal"][1]),
        "advice": parts["advice"][[0, 2, 1]],
        "occupied": parts["occupied"][::-1],
        "seen": parts["seen"][::-1],
        "visits": parts["visits"][::-1][:, :, turned],
        "block_visits": parts["block_visits"][::-1],
        "tries": Tries(parts["tries"].blocks[::-1], parts["tries"].goal),
    }


def quarter_turned(parts):
    """Return the same world turned by 90 degrees to the left."""
    state, (x, y) = parts["state"], parts["goal"]

    def turned(array):
        return np.rot90(array, k=-1).copy()  # rows run north, so the sense of rotation is reversed

    return parts | {
        "state": LatticeState(CELLS - 1 - state.iy, state.ix, (state.heading + 2) % 8),
        "goal": (-y, x),
        "occupied": turned(parts["occupied"]),
        "seen": turned(parts["seen"]),
        "visits": np.roll(turned(parts["visits"]), 2, axis=2),
        "block_visits": turned(parts["block_visits"]),
        "tries": Tries(turned(parts["tries"].blocks), parts["tries"].goal),
    }


def situation(parts):
    parts = {name: np.ascontiguousarray(part) if isinstance(part, np.ndarray) else part for name, part in parts.items()}
    blocked = TABLE.blocked(parts["occupied"])
    return Situation(
        grid=GRID,
        moves=BlockedMoves.from_array(blocked),
        gave_way=False,
        goals=goal_mask(GRID, parts["goal"], 0.6),
        drive_m=forward_search.path_lengths_from(blocked, parts["state"], path_costs(GRID)),
        **parts,
    )


def states(known, subgoal):
    rooms, options = features.measure_rooms(known), choices(known)
    return (
        features.low_state(known, subgoal, False, rooms),
        features.high_state(known, options, rooms),
        ~known.blocked[known.state.iy, known.state.ix, known.state.heading],
        options,
    )


def test_sizes_are_those_announced():
    low, high, mask, options = states(situation(world(0)), (1.0, 2.0))
    assert low.shape == (features.LOW_STATE_SIZE,) and low.dtype == np.float32
    assert high.shape == (features.HIGH_STATE_SIZE,) and high.dtype == np.float32
    assert mask.shape == (features.LOW_ACTIONS,) and options.mask.shape == (HIGH_ACTIONS,)


@pytest.mark.parametrize("seed", range(12))
def test_features_of_a_mirrored_world_are_the_mirrored_features(seed):
    parts = world(seed)
    low, high, mask, options = states(situation(parts), (3.0, -1.7))
    low_m, high_m, mask_m, options_m = states(situation(reflected(parts)), (3.0, 1.7))
    for level, state, state_m, allowed, allowed_m in (
        (Level.LOW, low, low_m, mask, mask_m),
        (Level.HIGH, high, high_m, options.mask, options_m.mask),
    ):
        mirror = features.mirror(level)
        np.testing.assert_allclose(state[mirror.state_index] * mirror.state_sign, state_m, atol=1e-5)
        assert (allowed[mirror.action_index] == allowed_m).all()


@pytest.mark.parametrize("seed", range(12))
def test_features_do_not_change_when_the_world_turns_with_the_car(seed):
    parts = world(seed)
    low, high, _, _ = states(situation(parts), (3.0, -1.7))
    low_t, high_t, _, _ = states(situation(quarter_turned(parts)), (1.7, 3.0))
    np.testing.assert_allclose(low, low_t, atol=1e-5)
    np.testing.assert_allclose(high, high_t, atol=1e-5)


@pytest.mark.parametrize("level", list(Level))
def test_mirroring_twice_changes_nothing(level):
    mirror = features.mirror(level)
    state = np.random.default_rng(0).normal(size=len(mirror.state_index))
    once = state[mirror.state_index] * mirror.state_sign
    assert (once[mirror.state_index] * mirror.state_sign == state).all()
    assert (mirror.action_index[mirror.action_index] == np.arange(len(mirror.action_index))).all()


def test_a_blocked_action_has_no_features_and_a_free_one_towards_the_subgoal_gains():
    parts = world(1) | {"occupied": np.zeros((FINE, FINE), bool), "state": LatticeState(10, 10, 0)}
    x, y = GRID.centre(10, 10)
    low, _, _, _ = states(situation(parts), (x + 4.0, y))
    per_action = low[: 5 * 12].reshape(5, 12)
    assert per_action[0, 0] == 1 and per_action[0, 1] > per_action[1, 1] > 0
    wall = parts["occupied"].copy()
    fx, fy = GRID.fine_index(x + 1.4, y)
    wall[fy - 2 : fy + 2, fx : fx + 3] = True
    low, _, mask, _ = states(situation(parts | {"occupied": wall}), (x + 4.0, y))
    assert not low[:12].any() and not mask[0]


@pytest.mark.parametrize("count", [5, 50, 500])
def test_the_state_of_a_car_that_drives_in_circles_keeps_changing(count):
    parts = world(1) | {"occupied": np.zeros((FINE, FINE), bool), "state": LatticeState(12, 12, 0)}

    def after(turns):
        counts = {name: np.full_like(parts[name], turns) for name in ("visits", "block_visits")}
        tries = Tries(np.full((4, 4), turns, np.int32), turns)
        return states(situation(parts | counts | {"tries": tries}), (3.0, -1.7))[:2]

    for earlier, later in zip(after(count), after(count + count // 5), strict=True):
        assert (later - earlier).max() > 0.1


def test_choices_keep_the_order_of_the_cars_heading():
    for heading in range(8):
        parts = world(2) | {"state": LatticeState(12, 12, heading), "occupied": np.zeros((FINE, FINE), bool)}
        options = choices(situation(parts))
        ahead = options.blocks[0] - (1, 1)
        assert math.atan2(ahead[1], ahead[0]) % math.tau == pytest.approx(heading * math.pi / 4)
        assert options.mask.all() and options.index_of((3, 3)) is None
        assert tuple(options.subgoals[GOAL_CHOICE]) == parts["goal"]


def test_blocks_beyond_the_edge_do_not_exist_and_walled_in_ones_cannot_be_chosen():
    walls = np.zeros((FINE, FINE), bool)
    border = GRID.fine_border
    walls[border + 28 : border + 36] = True  # an east-west wall between the first and the second row of blocks
    options = choices(situation(world(3) | {"state": LatticeState(2, 2, 0), "occupied": walls}))
    assert options.exists[[0, 1, 2]].all() and not options.exists[3:8].any()
    assert options.mask[0] and not options.mask[1] and not options.mask[2] and options.mask[GOAL_CHOICE]


def test_features_of_this_version_have_not_changed():
    """Recorded transitions hold such states. Who changes a feature raises `features.VERSION` and replaces the file."""
    assert FEATURES["version"] == features.VERSION
    for seed, expected in enumerate(FEATURES["states"]):
        low, high, *_ = states(situation(world(seed)), (1.0, 2.0))
        assert np.allclose(low, expected["low"], atol=1e-4) and np.allclose(high, expected["high"], atol=1e-4)
