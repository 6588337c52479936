"""Greedy episodes of an evaluation, driven and recorded."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from zsdist.config import Config
from zsdist.driving.episode import DrivingEnv, Episode
from zsdist.evaluation.drivers import Driver, Observability, Observed, Thought
from zsdist.evaluation.oracle_view import true_view
from zsdist.evaluation.records import EpisodeRecord, path_length_m
from zsdist.planning import shortest_path
from zsdist.planning.footprint import FootprintTable
from zsdist.planning.grid import Grid
from zsdist.planning.rewards import RewardTerms
from zsdist.sim.physics.collision import clearance_m
from zsdist.sim.scenes.scene import Scene
from zsdist.sim.scenes.solvability import footprints
from zsdist.types import Outcome, Pose


@dataclass(frozen=True)
class Moment:
    """One decision, or the end of an episode, as it is shown to a watcher.

    Attributes:
        scene: scene that is driven.
        observed: observation of the driver.
        people: `(W, 2)` metres, positions of the walking obstacles; None where nobody walks.
        action: chosen action; None at the end.
        thought: decision behind the action and its situation; None for a driver without them.
        outcome: outcome of the episode; None before its end.
        time_s: simulated time since the start.
        rewards: rewards of the action before; None at the start.
    """

    scene: Scene
    observed: Observed
    people: np.ndarray | None
    action: int | None
    thought: Thought | None
    outcome: Outcome | None
    time_s: float = 0.0
    rewards: RewardTerms | None = None


Watch = Callable[[Moment], None]


class WalkedEnv(DrivingEnv, Protocol):
    """Environment whose unwrapped form has a `world` that knows the positions of walking obstacles."""

    @property
    def unwrapped(self) -> Any:
        """Environment without wrappers."""


class Course:
    """Shortest drivable path of one scene, with which a driven path is compared.

    Args:
        scene: scene with the true obstacles; walking ones are left out.
        table: footprints of the actions.
        success_radius_m: distance from the goal within which it is reached.
    """

    def __init__(self, scene: Scene, table: FootprintTable, success_radius_m: float) -> None:
        self._grid = table.grid
        self._blocked = table.blocked(scene.occupancy(table.grid))
        self._metres = shortest_path.metres_cost(table.grid)
        self._goals = shortest_path.goal_mask(table.grid, scene.goal, success_radius_m)
        self._cost = shortest_path.cost_to_go(self._blocked, self._goals, self._metres)
        self._start = table.grid.lattice_state(scene.start.pose)

    def length_m(self, pose: Pose) -> float | None:
        """Return the metres to the goal from the lattice state nearest to a pose; None where no path leads there."""
        state = self._grid.lattice_state(pose)
        if not math.isfinite(self._cost[state.iy, state.ix, state.heading]):
            return None
        way = shortest_path.path(self._cost, self._blocked, state, self._metres)
        return shortest_path.length_m(way.states, self._grid.cell_size_m)

    def fewest_steps(self) -> int | None:
        """Return the fewest actions from the start to the goal; None where there is no path."""
        costs = shortest_path.cost_to_go(self._blocked, self._goals, shortest_path.STEPS_COST)
        fewest = float(costs[self._start.iy, self._start.ix, self._start.heading])
        return int(fewest) if math.isfinite(fewest) else None


class EpisodeRunner:
    """Runner of episodes with one driver in one environment.

    Args:
        env: `CarNavigation`, or an environment with its observations and infos.
        config: configuration of the run; grid, camera and success radius are used.
        driver: driver that chooses the actions.
        observability: part of its surroundings that the driver observes.
        clock: returns monotonic seconds, with which decisions are timed.

    Attributes:
        driver: the driver.
    """

    def __init__(
        self,
        env: WalkedEnv,
        config: Config,
        driver: Driver,
        observability: Observability,
        clock: Callable[[], float],
    ) -> None:
        self._env = env
        self._config = config
        self.driver = driver
        self._observability = observability
        self._clock = clock
        self._table = footprints(Grid.from_config(config.grid))

    def drive(self, scene: Scene, rng: np.random.Generator, watch: Watch | None = None) -> EpisodeRecord:
        """Drive one episode and return its record.

        Args:
            scene: scene to drive.
            rng: generator of the driver.
            watch: called with every decision as it is made, and with the end.
        """
        driver = self.driver
        episode = Episode(self._env, scene)
        driver.begin(episode.pose, scene.goal, scene if self._observability is Observability.MAP else None, rng)
        decision_ms: list[float] = []
        least_m = self._clearance_m(scene, episode.pose)
        time_s, rewards = 0.0, None
        while not episode.over:
            observed = self._observed(episode, scene)
            began_s = self._clock()
            action = driver.act(observed)
            decision_ms.append(round(1000 * (self._clock() - began_s), 3))
            if watch is not None:
                people = self._people(scene)
                watch(Moment(scene, observed, people, action, driver.thought, None, time_s, rewards))
            rewards, outcome = episode.step(action)
            driver.result(rewards, outcome)
            time_s += episode.info["sim_steps"] * self._config.sim.step_s
            least_m = min(least_m, self._clearance_m(scene, episode.pose))
        if watch is not None:
            end, people = self._observed(episode, scene), self._people(scene)
            watch(Moment(scene, end, people, None, driver.thought, episode.outcome, time_s, rewards))
        return self._record(scene, episode, least_m, decision_ms)

    def _record(self, scene: Scene, episode: Episode, least_m: float, decision_ms: list[float]) -> EpisodeRecord:
        poses, outcome = episode.poses, episode.outcome
        assert outcome is not None, "only an episode that is over is recorded"
        course = Course(scene, self._table, self._config.sim.success_radius_m)
        return EpisodeRecord(
            scene=scene.name,
            outcome=outcome,
            steps=len(decision_ms),
            fewest_steps=course.fewest_steps(),
            path_m=path_length_m(poses),
            shortest_m=course.length_m(poses[0]),
            remaining_m=next((way for pose in reversed(poses) if (way := course.length_m(pose)) is not None), None),
            min_clearance_m=0.0 if outcome is Outcome.COLLISION else least_m,
            static=not scene.walkers(),
            decision_ms=tuple(decision_ms),
            shield_changes=self.driver.shield_changes,
            poses=tuple(poses),
        )

    def _observed(self, episode: Episode, scene: Scene) -> Observed:
        pose, truth = episode.pose, None
        if self._observability is Observability.RANGES:
            truth = true_view(scene, pose, self._config.camera, self._config.grid.arena_m, self._people(scene))
        allowed = episode.info["action_mask"].astype(bool)
        return Observed(episode.observation.get("image"), pose, scene.goal, allowed, truth)

    def _people(self, scene: Scene) -> np.ndarray | None:
        return self._env.unwrapped.world.people if scene.walkers() else None

    def _clearance_m(self, scene: Scene, pose: Pose) -> float:
        circles = scene.circles(self._people(scene))
        return clearance_m(pose, circles, scene.boxes(), arena_m=self._config.grid.arena_m)
