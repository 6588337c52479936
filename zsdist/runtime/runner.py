"""Runner of a bundle: pictures, poses and a goal in; actions and the believed map out."""

from dataclasses import dataclass

import numpy as np

from zsdist.planning.belief import BeliefMap
from zsdist.runtime.bundle import Bundle
from zsdist.types import Action, Pose


@dataclass(frozen=True)
class RunnerDecision:
    """Decision of a runner at one pose.

    Attributes:
        action: action to take; None: stay where you are, since one of `arrived` and `no_way` says why.
        target: pose at which the action ends, on the grid: turn in place, then advance; None without an action.
        subgoal: `(x_m, y_m)` that the action leads to; None without an action.
        values: `(5,)` float32, value of each action, or None without an action or without a low-level network.
        allowed: `(5,)` bool, actions that the believed map allows; None where it was not asked.
        arrived: whether the goal is reached.
        no_way: reason for which there is no action although the goal is not reached; None otherwise.
    """

    action: Action | None
    target: Pose | None
    subgoal: tuple[float, float] | None
    values: np.ndarray | None
    allowed: np.ndarray | None
    arrived: bool = False
    no_way: str | None = None


class BundleRunner:
    """Exported policy that decides for one robot, by the code that actors and evaluations use.

    Poses and goals are in the frame of the arena: metres from its centre, x east, y north, headings counter-clockwise
    from east. Call `begin`, then `decide` whenever the last action has ended.

    Args:
        bundle: bundle of the policy.
        threads: number of threads of each network.
    """

    def __init__(self, bundle: Bundle, threads: int = 1) -> None:
        self.bundle = bundle

    def begin(self, pose: Pose, goal_m: tuple[float, float]) -> None:
        """Forget the map, and begin at a pose; the ground within 1.5 m of it counts as free.

        Raises:
            BundleError: pose or goal is not on the grid.
        """
        raise NotImplementedError

    def set_goal(self, goal_m: tuple[float, float]) -> None:
        """Take another goal and keep the map.

        Raises:
            BundleError: the goal is not on the grid.
        """
        raise NotImplementedError

    def decide(self, picture: np.ndarray, pose: Pose) -> RunnerDecision:
        """Return the next action.

        Args:
            picture: `(h, w, 3)` uint8, red, green, blue, by a camera such as the bundle's; it may have another size.
            pose: pose of the robot's centre at which the picture was taken.

        Raises:
            BundleError: the picture has another shape or dtype, or the pose is not finite.
        """
        raise NotImplementedError

    @property
    def belief(self) -> BeliefMap:
        """Map that the robot believes, on the fine grid of `bundle.grid`."""
        raise NotImplementedError
