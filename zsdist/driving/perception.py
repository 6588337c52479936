"""Perception of an actor's cars: readings of camera pictures, taken from a cache where that changes nothing."""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from zsdist.planning.grid import Grid
from zsdist.types import LatticeState, Pose, View
from zsdist.vision.fingerprint import VisionHashes
from zsdist.vision.ray_ablation import ablate_rays
from zsdist.vision.reading import Reading
from zsdist.vision.reading_cache import ReadingCache

NEAR_M = 0.10  # a car within both limits of a lattice state may use the reading made there
NEAR_RAD = math.radians(5.0)


class VisionModel(VisionHashes, Protocol):
    """Part of `zsdist.vision.visual_act.VisualAct` that is used."""

    def read(self, images: np.ndarray) -> Reading:
        """Return the reading of images `(B, px, px, 3)`."""

    def views(self, reading: Reading, goal_bearing_rad: np.ndarray, goal_distance_m: np.ndarray) -> list[View]:
        """Return the views of a reading with the advice for goals, `(B,)` bearings in rad and distances in metres."""


class PerceivingCar(Protocol):
    """Part of `zsdist.driving.actor_car.ActorCar` that is used."""

    @property
    def trains(self) -> bool:
        """True if it drives a training episode."""

    @property
    def scene_hash(self) -> str | None:
        """Hash of the scene; None where its readings may not be cached."""

    @property
    def pose(self) -> Pose:
        """True pose of the car."""

    def picture(self, pose: Pose | None = None) -> np.ndarray:
        """Return the camera's picture at the true pose, or for a level car at `pose`, `(px, px, 3)` uint8."""

    def goal_from_here(self) -> tuple[float, float]:
        """Return bearing (rad, left positive) and distance (m) of the goal from the car."""


class _Spot(NamedTuple):
    """Key of a cached reading: the hash of the scene, and the lattice state."""

    scene: str
    state: LatticeState


class Perception:
    """Visual-act model shared by several cars, with a cache of its readings.

    Readings are cached in training episodes without walkers, for cars within `NEAR_M` and `NEAR_RAD` of a lattice
    state. A cached reading is made from a picture at the lattice state itself, for a level car, so it does not depend
    on who makes it or when. The content of the cache therefore changes no view, only the time that a view takes. In all
    other cases, and in every drive of a candidate, the picture is taken at the true pose.

    Args:
        visual_act: vision model.
        grid: grid with the lattice on which the cars drive.
        rays: rays that reach the cars, as `zsdist.vision.ray_ablation.ablate_rays` accepts them.
        cache: cache of readings; None: every picture is taken at the true pose.

    Attributes:
        hits: number of readings that were in the cache.
        misses: number of readings that were not, and were added.
        bypasses: number of pictures of training episodes that were taken at the true pose, past the cache.
    """

    def __init__(self, visual_act: VisionModel, grid: Grid, rays: str, cache: ReadingCache | None) -> None:
        self._visual_act, self._grid, self._rays, self._cache = visual_act, grid, rays, cache
        self.hits = self.misses = self.bypasses = 0

    def views(self, cars: Sequence[PerceivingCar]) -> list[View]:
        """Return the view of each car, with the advice for its goal.

        A picture is rendered only where no reading is cached.
        """
        spots = [self._spot(car) for car in cars]
        remembered = [self._find(spot) for spot in spots]
        readings = [
            self._read(car, spot) if reading is None else reading
            for car, spot, reading in zip(cars, spots, remembered, strict=True)
        ]
        self.hits += sum(reading is not None for reading in remembered)
        self.bypasses += sum(car.trains and spot is None for car, spot in zip(cars, spots, strict=True))
        goals = np.array([car.goal_from_here() for car in cars], dtype=np.float32)
        together = Reading(*(np.stack(parts) for parts in zip(*readings, strict=True)))
        return [ablate_rays(view, self._rays) for view in self._visual_act.views(together, goals[:, 0], goals[:, 1])]

    def statistics(self) -> dict[str, float]:
        """Return the counts of hits, misses and bypasses; empty without a cache."""
        if self._cache is None:
            return {}
        return {"cache_hits": self.hits, "cache_misses": self.misses, "cache_bypasses": self.bypasses}

    def close(self) -> None:
        """Release the cache, once no car drives any more."""
        if self._cache is not None:
            self._cache.close()

    def _spot(self, car: PerceivingCar) -> _Spot | None:
        """Return the key of a cached reading that may serve a car; None where none may."""
        if self._cache is None or car.scene_hash is None:
            return None
        pose = car.pose
        state = self._grid.lattice_state(pose)
        there = self._grid.pose(state)
        turn = math.remainder(there.heading_rad - pose.heading_rad, math.tau)
        near = math.dist(there[:2], pose[:2]) <= NEAR_M and abs(turn) <= NEAR_RAD
        return _Spot(car.scene_hash, state) if near else None

    def _find(self, spot: _Spot | None) -> Reading | None:
        return None if spot is None or self._cache is None else self._cache.find(*spot)

    def _read(self, car: PerceivingCar, spot: _Spot | None) -> Reading:
        """Return the reading of a new picture, at the lattice state of `spot` and cached; None: at the true pose."""
        picture = car.picture(None if spot is None else self._grid.pose(spot.state))
        # One at a time: in a batch, the last bits of a reading depend on the size of the batch.
        reading = Reading(*(part[0] for part in self._visual_act.read(picture[None])))
        if spot is None or self._cache is None:
            return reading
        self.misses += 1
        return self._cache.keep(*spot, reading)
