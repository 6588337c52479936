"""Families of random scenes, generated from (family, seed); every scene is solvable.

The same family and seed give the same scene in every process. A scene in which the car's footprint has no free path
over (cell, heading) is drawn again from the same stream of random numbers.
"""

from collections.abc import Callable

import numpy as np

from zsdist.common import random_streams
from zsdist.errors import SceneError
from zsdist.planning.grid import HEADINGS
from zsdist.sim.scenes import families_layout
from zsdist.sim.scenes.families_canvas import Canvas, Redraw, turned
from zsdist.sim.scenes.kinds import GROUNDS, KINDS
from zsdist.sim.scenes.manifest import TRAINED_GROUNDS, WITHHELD_GROUNDS, Split, split_seed
from zsdist.sim.scenes.scene import DEFAULT_GRID, Scene, check
from zsdist.sim.scenes.solvability import solve
from zsdist.types import LatticeState

__all__ = ["FAMILIES", "SINGLETON", "SINGLETON_SCENES", "draw", "generate", "split_seed"]

SINGLETON, SINGLETON_SCENES = "singleton", 10
MAX_SEED = 2**31
MAX_TRIES = 200
LEAST_WAY_M = 10.0  # least distance between start and goal
OFF_EAST_DEG = 60.0  # `ood-start-goal`: least angle between east and the direction to the goal; in `iid` it is less

# Weights with which kinds are drawn.
WILD = {"tree": 0.6, "bush": 0.15, "pole": 0.1, "person": 0.15}
SMALL = {"tree": 0.35, "bush": 0.25, "pole": 0.25, "person": 0.15}
VARIED = {"box": 0.3, "car": 0.15, "pole": 0.2, "person": 0.15, "bush": 0.2}
NEW = {"sand_pile": 0.5, "rock": 0.5}
EVERY = {"tree": 0.3, "sand_pile": 0.2, "rock": 0.2, "bush": 0.1, "pole": 0.05, "person": 0.15}


def generate(family: str, seed: int) -> Scene:
    """Return the scene of a family and a seed, checked and solvable.

    Args:
        family: a key of `FAMILIES`.
        seed: seed of the scene, 0 or more; for `singleton`, the number of one of its ten scenes.

    Raises:
        SceneError: no such family, a seed out of range, or no solvable scene in `MAX_TRIES` draws.
    """
    return generate_counted(family, seed)[0]


def draw(family: str, split: Split, index: int) -> Scene:
    """Return the `index`-th scene of a family's split; `singleton` has the same ten scenes in every split."""
    return generate(family, index % SINGLETON_SCENES if family == SINGLETON else split_seed(split, index))


def generate_counted(family: str, seed: int) -> tuple[Scene, int]:
    """Return the scene of `generate`, and the number of draws that it took."""
    if family not in FAMILIES:
        raise SceneError(f"scene family is {family!r}; allowed are {', '.join(FAMILIES)}")
    most = SINGLETON_SCENES if family == SINGLETON else MAX_SEED
    if not 0 <= seed < most:
        raise SceneError(f"seed of a {family} scene is {seed}; allowed is 0 to {most - 1}")
    rng = random_streams.scene(list(FAMILIES).index(family), seed)
    for tries in range(1, MAX_TRIES + 1):
        try:
            scene = FAMILIES[family](rng, f"{family}-{seed:06d}")
        except Redraw:
            continue
        if solve(scene) is not None:
            check(scene)
            return scene, tries
    raise SceneError(f"scene {family}-{seed:06d}: none of {MAX_TRIES} draws was solvable")


def _west_to_east(rng: np.random.Generator, border: int = 3) -> Canvas:
    """Draw a start in the four western columns and a goal in the four eastern ones, `border` rows from the edges."""
    last = DEFAULT_GRID.cells - 1
    rows = rng.integers(border, last + 1 - border, 2)
    columns = rng.integers(0, 4, 2)
    start = LatticeState(int(columns[0]), int(rows[0]), int(rng.integers(HEADINGS)))
    return Canvas(rng, start, (last - int(columns[1]), int(rows[1])))


def _not_eastwards(rng: np.random.Generator) -> Canvas:
    """Draw a start and a goal anywhere, 10 m or more apart, in a direction more than `OFF_EAST_DEG` from east."""
    while True:
        cells = rng.integers(1, DEFAULT_GRID.cells - 1, 4)
        dx, dy = (cells[2:] - cells[:2]) * DEFAULT_GRID.cell_size_m
        if np.hypot(dx, dy) >= LEAST_WAY_M and abs(np.degrees(np.arctan2(dy, dx))) > OFF_EAST_DEG:
            start = LatticeState(int(cells[0]), int(cells[1]), int(rng.integers(HEADINGS)))
            return Canvas(rng, start, (int(cells[2]), int(cells[3])))


def _ground(rng: np.random.Generator, allowed: tuple[str, ...]) -> str:
    return allowed[int(rng.integers(len(allowed)))]


def _iid(rng: np.random.Generator, name: str) -> Scene:
    canvas = _west_to_east(rng)
    canvas.scatter(int(rng.integers(12, 21)), WILD)
    return canvas.scene(name, _ground(rng, TRAINED_GROUNDS))


def _start_goal(rng: np.random.Generator, name: str) -> Scene:
    canvas = _not_eastwards(rng)
    canvas.scatter(int(rng.integers(12, 21)), WILD)
    return canvas.scene(name, _ground(rng, TRAINED_GROUNDS))


def _layout(rng: np.random.Generator, name: str) -> Scene:
    canvas = _west_to_east(rng)
    families_layout.walls(canvas)
    canvas.scatter(int(rng.integers(2, 6)), WILD, gap_m=families_layout.PASSAGE_M)
    return canvas.scene(name, _ground(rng, TRAINED_GROUNDS))


def _clusters(rng: np.random.Generator, name: str) -> Scene:
    canvas = _west_to_east(rng)
    _add_clusters(canvas, WILD)
    return canvas.scene(name, _ground(rng, TRAINED_GROUNDS))


def _add_clusters(canvas: Canvas, kinds: dict[str, float]) -> None:
    rng = canvas.rng
    start, goal = np.array(canvas.ends)
    centres = [start + (goal - start) * rng.uniform(0.35, 0.65)]  # one is on the straight line to the goal
    centres += [rng.uniform(-7.0, 7.0, 2) for _ in range(int(rng.integers(2, 5)))]
    for centre in centres:
        canvas.scatter(int(rng.integers(4, 8)), kinds, gap_m=0.02, scale=0.8, centre=centre, spread_m=2.6)


def _density(rng: np.random.Generator, name: str) -> Scene:
    canvas = _west_to_east(rng)
    canvas.scatter(int(rng.integers(28, 41)), SMALL, scale=0.5)
    return canvas.scene(name, _ground(rng, TRAINED_GROUNDS))


def _appearance(rng: np.random.Generator, name: str) -> Scene:
    canvas = _west_to_east(rng)
    canvas.scatter(int(rng.integers(12, 21)), NEW)
    return canvas.scene(name, _ground(rng, WITHHELD_GROUNDS))


def _dynamic(rng: np.random.Generator, name: str) -> Scene:
    canvas = _west_to_east(rng)
    canvas.scatter(int(rng.integers(9, 15)), WILD)
    canvas.walkers(int(rng.integers(3, 7)))
    return canvas.scene(name, _ground(rng, TRAINED_GROUNDS))


def _all(rng: np.random.Generator, name: str) -> Scene:
    """Return a scene with withheld kinds and ground, walking people, and walls, clusters or many small obstacles."""
    plan = int(rng.integers(3))
    if plan == 0:
        canvas = _west_to_east(rng)
        families_layout.walls(canvas)
        canvas.scatter(int(rng.integers(2, 6)), EVERY, gap_m=families_layout.PASSAGE_M)
    else:
        canvas = _not_eastwards(rng)
        if plan == 1:
            _add_clusters(canvas, EVERY)
        else:
            canvas.scatter(int(rng.integers(22, 33)), EVERY, scale=0.6)
    canvas.walkers(int(rng.integers(1, 5)))
    scene = canvas.scene(name, _ground(rng, WITHHELD_GROUNDS))
    return turned(scene, int(rng.integers(1, 4))) if plan == 0 else scene


def _street(rng: np.random.Generator, name: str) -> Scene:
    canvas = _west_to_east(rng, border=13)
    families_layout.street(canvas)
    return turned(canvas.scene(name, "asphalt"), int(rng.integers(4)))


def _varied(rng: np.random.Generator, name: str) -> Scene:
    canvas = _not_eastwards(rng) if rng.random() < 0.5 else _west_to_east(rng)
    canvas.scatter(int(rng.integers(1, 5)), {"pole": 1.0}, scale=4.0)  # columns as thick as a trunk
    canvas.scatter(int(rng.integers(6, 21)), VARIED, scale=float(rng.uniform(0.6, 1.4)))
    return canvas.scene(name, _ground(rng, TRAINED_GROUNDS))


def _vocabulary(rng: np.random.Generator, name: str) -> Scene:
    """Return a scene with a few obstacles of any kind on any ground, for learning words."""
    canvas = _not_eastwards(rng)
    canvas.scatter(int(rng.integers(5, 13)), dict.fromkeys(KINDS, 1.0), gap_m=0.6)
    return canvas.scene(name, _ground(rng, tuple(GROUNDS)))


# The position of a family in this dictionary is part of its scenes' seeds: append only.
FAMILIES: dict[str, Callable[[np.random.Generator, str], Scene]] = {
    SINGLETON: _iid,
    "iid": _iid,
    "ood-start-goal": _start_goal,
    "ood-layout": _layout,
    "ood-clusters": _clusters,
    "ood-density": _density,
    "ood-appearance": _appearance,
    "ood-dynamic": _dynamic,
    "ood-all": _all,
    "street": _street,
    "varied": _varied,
    "vocabulary": _vocabulary,
}
