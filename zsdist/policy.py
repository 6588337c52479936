"""Policies for programs: `zsdist.load_policy("pretrained")`, and then one action for each observation."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from zsdist.common import random_streams
from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.evaluate import find_policy
from zsdist.evaluation.contenders import FULL, Contender
from zsdist.evaluation.drivers import Driver, Observability, Observed
from zsdist.evaluation.workers import Simulation
from zsdist.planning.grid import Grid
from zsdist.planning.lattice import NOWHERE, flat_state, successors
from zsdist.planning.rewards import RewardTerms
from zsdist.types import Pose

MOST_M = 2.0  # an action moves the car by less
_NOTHING = RewardTerms(0.0, 0.0, 0.0)  # a greedy policy learns nothing


def load_policy(name: str = "pretrained", variant: str = FULL, simulation: Simulation | None = None) -> "DrivingPolicy":
    """Return a policy that drives by the observations of `zsdist/CarNavigation-v0`.

    Args:
        name: `pretrained`, a run directory or a checkpoint, or a baseline that observes the camera or nothing.
        variant: variant of a learned policy, as `zsdist evaluate --list` names them.
        simulation: factory of the vision model; None: that of the policy's configuration.

    Raises:
        RunError: the policy observes more than an observation has.
        ZsdistError: there is no such policy, or its weights do not fit this machine.
    """
    contender = find_policy(name, variant=variant).contender
    if contender.observability not in (Observability.CAMERA, Observability.NOTHING):
        raise RunError(
            f"policy {name!r} observes {contender.observability}, which no observation has; allowed are policies that "
            f"observe {Observability.CAMERA}, or {Observability.NOTHING}"
        )
    return DrivingPolicy(contender, simulation or Simulation())


class DrivingPolicy:
    """Policy of one car. It remembers what the car has seen, so `reset` begins each episode.

    Args:
        contender: policy that drives, greedily.
        simulation: factory of the vision model.

    Attributes:
        config: configuration of the policy. An environment with it has the camera that the policy expects.
    """

    def __init__(self, contender: Contender, simulation: Simulation) -> None:
        self.config: Config = contender.config
        self._sees = contender.observability is Observability.CAMERA
        self._driver: Driver = contender.driver(simulation.load_vision(contender.config) if self._sees else None)
        self._grid = Grid.from_config(contender.config.grid)
        self._last: Observed | None = None
        self._seed, self._episode = 0, -1
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Forget the episode; the next observation begins another one.

        Args:
            seed: seed of the policies that draw at random, from here on; None: go on.
        """
        if seed is not None:
            self._seed, self._episode = seed, -1
        self._episode += 1
        self._last = None

    def act(self, observation: Mapping[str, Any]) -> int:
        """Return the action for an observation of the environment, 0 to 4.

        Args:
            observation: has `image`, `pose` and `goal`, as the environment gives them.

        Raises:
            RunError: the image has another size than the policy's camera, or the observation is of another episode.
        """
        observed = self._observed(observation)
        if self._last is None:
            rng = random_streams.evaluated_episode(self._seed, self._episode)
            self._driver.begin(observed.pose, observed.goal, None, rng)
        else:
            moved_m = math.dist(observed.pose[:2], self._last.pose[:2])
            if moved_m > MOST_M or observed.goal != self._last.goal:
                raise RunError(
                    f"the car is {moved_m:.2f} m from where it was, with the goal at {observed.goal}: another episode "
                    "has begun; call reset() before the first observation of each"
                )
            self._driver.result(_NOTHING, None)
        self._last = observed
        return self._driver.act(observed)

    def _observed(self, observation: Mapping[str, Any]) -> Observed:
        pose = Pose(*np.asarray(observation["pose"], np.float64).tolist())
        x_m, y_m = np.asarray(observation["goal"], np.float64).tolist()
        image = np.asarray(observation["image"]) if self._sees and observation.get("image") is not None else None
        side, shape = self.config.camera.size_px, () if image is None else image.shape
        if self._sees and shape != (side, side, 3):
            raise RunError(
                f"the observation's image has shape {shape}; allowed is ({side}, {side}, 3): make the "
                "environment with config=policy.config"
            )
        state = flat_state(self._grid.lattice_state(pose), self._grid.cells)
        return Observed(image, pose, (x_m, y_m), successors(self._grid.cells)[state] != NOWHERE)
