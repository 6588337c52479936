"""Runner of a bundle: pictures, poses and a goal in; actions and the believed map out."""

import math
from dataclasses import dataclass

import numpy as np

from zsdist.agent.hierarchy import HierarchicalAgent
from zsdist.driving.settings import agent_settings
from zsdist.errors import BundleError
from zsdist.planning.belief import BeliefMap
from zsdist.planning.footprint import successor
from zsdist.planning.rewards import RewardTerms
from zsdist.runtime.bundle import Bundle
from zsdist.runtime.graphs import BundleVision, q_networks
from zsdist.types import Action, Level, Pose

LEAST_PX = 32
_NOTHING = RewardTerms(0.0, 0.0, 0.0)  # nothing is learned


@dataclass(frozen=True)
class RunnerDecision:
    """Decision of a runner at one pose.

    Attributes:
        action: action to take; None where the goal is reached, or after as many actions as the policy may take.
        target: pose at which the action ends, on the grid: turn in place, then advance; None without an action.
        subgoal: `(x_m, y_m)` that the action leads to; None without an action.
        masks: choices that each level may make, `(9,)` and `(5,)` bool; empty without an action.
        values: values of each level that decided now, `(9,)` and `(5,)` float32; empty without an action.
        arrived: whether the goal is reached.
        no_way: reason not to move although the goal is not reached; None where there is none. With an action, the
            policy would try it in simulation: every action hits something on the believed map, and it is a turn in
            place that may show a way.
    """

    action: Action | None
    target: Pose | None
    subgoal: tuple[float, float] | None
    masks: dict[Level, np.ndarray]
    values: dict[Level, np.ndarray]
    arrived: bool = False
    no_way: str | None = None


class BundleRunner:
    """Exported policy that decides for one robot, by the code that actors and evaluations use.

    Poses and goals are in the frame of the arena: metres from its centre, x east, y north, headings counter-clockwise
    from east. Call `begin`, then `decide` whenever the last action has ended.

    Args:
        bundle: bundle of the policy.
        threads: number of threads of each network.

    Attributes:
        bundle: bundle of the policy.
        actions_taken: number of actions since the last `begin` or `set_goal`.

    Raises:
        BundleError: onnxruntime cannot open a network of the bundle.
    """

    def __init__(self, bundle: Bundle, threads: int = 1) -> None:
        self.bundle = bundle
        self.actions_taken = 0
        self._vision = BundleVision(bundle, threads)
        self._q = q_networks(bundle, threads)
        self._agent = HierarchicalAgent(agent_settings(bundle.config))
        self._goal: tuple[float, float] | None = None
        self._belief: BeliefMap | None = None
        self._pending = False  # whether the agent still has to begin, at the pose of the next decision

    def begin(self, pose: Pose, goal_m: tuple[float, float]) -> None:
        """Forget the map, and begin at a pose; the ground within 1.5 m of it counts as free.

        Args:
            pose: pose of the robot's centre.
            goal_m: `(x, y)` of the goal in metres.

        Raises:
            BundleError: the pose is not in the arena, or the goal not on the grid.
        """
        self._goal = self._checked_goal(goal_m)
        self._begin(self._checked_pose(pose), None)

    def set_goal(self, goal_m: tuple[float, float]) -> None:
        """Take another goal and keep the map; what was tried towards the old one is forgotten.

        Args:
            goal_m: `(x, y)` of the goal in metres.

        Raises:
            BundleError: the goal is not on the grid, or nothing has begun.
        """
        if self._belief is None:
            raise BundleError("no drive has begun; call begin(pose, goal) before set_goal")
        self._goal = self._checked_goal(goal_m)
        self._pending = True

    def decide(self, picture: np.ndarray, pose: Pose) -> RunnerDecision:
        """Return the next action.

        Args:
            picture: `(px, px, 3)` uint8, red, green, blue, by a camera such as the bundle's; its size is free.
            pose: pose of the robot's centre at which the picture was taken.

        Raises:
            BundleError: the picture has another shape or dtype, the pose is not in the arena, or nothing has begun.
        """
        goal = self._goal
        if goal is None:
            raise BundleError("no drive has begun; call begin(pose, goal) before decide")
        pose = self._checked_pose(pose)
        _check_picture(picture)
        if self._pending:
            self._begin(pose, self._belief)
        most = self.bundle.manifest.limits.max_steps
        if math.dist(pose[:2], goal) <= self.bundle.manifest.limits.success_radius_m:
            return RunnerDecision(None, None, None, {}, {}, arrived=True)
        if self.actions_taken >= most:
            reason = f"{most} actions have not led to the goal, the most that the policy may take"
            return RunnerDecision(None, None, None, {}, {}, no_way=reason)
        if self.actions_taken:
            self._agent.result(_NOTHING, None)
        self._agent.observe(pose, self._vision.view(picture, *pose.towards(*goal)))
        decision = self._agent.act(self._q)
        self.actions_taken += 1
        grid = self.bundle.grid
        return RunnerDecision(
            action=decision.action,
            target=grid.pose(successor(grid.lattice_state(pose), decision.action)),
            subgoal=decision.subgoal,
            masks=decision.masks,
            values=decision.values,
            no_way="every action hits something on the believed map" if decision.stuck else None,
        )

    @property
    def belief(self) -> BeliefMap:
        """Map that the robot believes, on the fine grid of `bundle.grid`.

        Raises:
            BundleError: nothing has begun.
        """
        if self._belief is None:
            raise BundleError("no drive has begun; call begin(pose, goal) before belief")
        return self._belief

    def _begin(self, pose: Pose, belief: BeliefMap | None) -> None:
        assert self._goal is not None, "a drive has a goal"
        rng = np.random.default_rng(0)  # nothing is drawn from it that decides
        self._agent.begin(pose, self._goal, epsilon=0.0, shielded=True, rng=rng, belief=belief)
        self._belief, self._pending, self.actions_taken = self._agent.belief, False, 0

    def _checked_goal(self, goal_m: tuple[float, float]) -> tuple[float, float]:
        x_m, y_m = float(goal_m[0]), float(goal_m[1])
        if not self.bundle.grid.contains(x_m, y_m):
            half = self.bundle.grid.side_m / 2
            raise BundleError(
                f"goal ({x_m:g}, {y_m:g}) m is off the policy's grid; allowed is -{half:g} to below {half:g} m on both "
                "axes of the arena"
            )
        return x_m, y_m

    def _checked_pose(self, pose: Pose) -> Pose:
        pose, half = Pose(*(float(value) for value in pose)), self.bundle.grid.arena_m / 2
        if not (abs(pose.x_m) <= half and abs(pose.y_m) <= half and math.isfinite(pose.heading_rad)):
            raise BundleError(
                f"pose is ({pose.x_m:g}, {pose.y_m:g}) m, {pose.heading_rad:g} rad; allowed is within {half:g} m of "
                "the arena's centre on both axes, and a finite heading"
            )
        return pose


def _check_picture(picture: np.ndarray) -> None:
    """Raise `BundleError` unless a picture is square, of three channels of uint8, and not too small."""
    shape, dtype = np.shape(picture), getattr(picture, "dtype", type(picture).__name__)
    if dtype != np.uint8 or len(shape) != 3 or shape[2] != 3 or shape[0] != shape[1] or shape[0] < LEAST_PX:
        raise BundleError(
            f"picture is {shape} {dtype}; allowed is (px, px, 3) uint8, square, with {LEAST_PX} pixels or more a side"
        )
