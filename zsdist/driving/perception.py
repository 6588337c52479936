"""What an actor's cars see: looked at where it must be, remembered where it may be."""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from zsdist.driving.episode import Car
from zsdist.planning.grid import Grid
from zsdist.types import LatticeState, View
from zsdist.vision.fingerprint import VisionHashes
from zsdist.vision.reading_cache import ReadingCache
from zsdist.vision.visual_act import Reading

NEAR_M = 0.10  # a car this near to a lattice state, and with this heading, sees what is seen from there
NEAR_RAD = math.radians(5.0)


class VisionModel(VisionHashes, Protocol):
    """What is used of `zsdist.vision.visual_act.VisualAct`, whose docstrings say what its methods do."""

    def read(self, images: np.ndarray) -> Reading:
        """What images `(B, px, px, 3)` show."""

    def views(self, reading: Reading, goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> list[View]:
        """The same for goals `(B,)`."""


class Perception:
    """One visual-act model for several cars, and the memory of what it read.

    A reading is remembered for training episodes in scenes where nobody walks, and for cars that stand on the lattice
    within `NEAR_M` and `NEAR_RAD`. It is made from a picture at the lattice state itself, of a level car. So it is the
    same whoever makes it and when: what a car sees does not depend on what is in the memory, only the time it takes.
    Wherever that is not so, and in every evaluation drive, the picture is taken at the true pose.

    Args:
        visual_act: the model.
        grid: to whose lattice states the cars drive.
        cache: the memory; None: every picture is taken at the true pose.

    Attributes:
        hits: readings that were remembered.
        misses: readings that were not, and are now.
        bypasses: pictures of training episodes at the true pose, past the memory.
    """

    def __init__(self, visual_act: VisionModel, grid: Grid, cache: ReadingCache | None) -> None:
        self._visual_act, self._grid, self._cache = visual_act, grid, cache
        self.hits = self.misses = self.bypasses = 0

    def views(self, cars: Sequence[Car]) -> list[View]:
        """What each car sees, with the advice for its goal; a picture is rendered only where nothing is remembered."""
        states = [self._state(car) for car in cars]
        readings = [
            None if state is None else self._cache.find(car.scene_hash, state)
            for car, state in zip(cars, states, strict=True)
        ]
        unread = [index for index, reading in enumerate(readings) if reading is None]
        for index in unread:
            car, state = cars[index], states[index]
            picture = car.picture(None if state is None else self._grid.pose(state))
            # One at a time: read together with others, the last bits of a reading depend on how many there are.
            reading = Reading(*(part[0] for part in self._visual_act.read(picture[None])))
            readings[index] = reading if state is None else self._cache.keep(car.scene_hash, state, reading)
        self._count(cars, states, unread)
        goals = np.array([car.goal_seen_from_here() for car in cars], dtype=np.float32)
        together = Reading(*(np.stack(parts) for parts in zip(*readings, strict=True)))
        return self._visual_act.views(together, goals[:, 0], goals[:, 1])

    def statistics(self) -> dict[str, float]:
        """Counts of readings that were remembered, that were not, and that could not be; nothing without a cache."""
        if self._cache is None:
            return {}
        return {"cache_hits": self.hits, "cache_misses": self.misses, "cache_bypasses": self.bypasses}

    def close(self) -> None:
        """Lets go of the memory, once no car drives any more."""
        if self._cache is not None:
            self._cache.close()

    def _state(self, car: Car) -> LatticeState | None:
        """The lattice state at which a remembered reading would do for this car, None where none would."""
        if self._cache is None or car.scene_hash is None:
            return None
        pose = car.pose
        state = self._grid.lattice_state(pose)
        there = self._grid.pose(state)
        turn = math.remainder(there.heading_rad - pose.heading_rad, math.tau)
        return state if math.dist(there[:2], pose[:2]) <= NEAR_M and abs(turn) <= NEAR_RAD else None

    def _count(self, cars: Sequence[Car], states: Sequence[LatticeState | None], unread: Sequence[int]) -> None:
        may = sum(state is not None for state in states)
        missed = sum(states[index] is not None for index in unread)
        self.hits += may - missed
        self.misses += missed
        self.bypasses += sum(car.task.trains for car in cars) - may
