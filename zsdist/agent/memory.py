"""Memory of one car over one episode: its believed map, its visits, and the options that it has tried."""

import numpy as np

from zsdist.agent import shield
from zsdist.agent.reward_shaping import path_costs
from zsdist.agent.shield import Judgement
from zsdist.agent.situation import Situation, Tries
from zsdist.common import finite
from zsdist.planning import forward_search
from zsdist.planning.belief import BeliefMap
from zsdist.planning.grid import HEADINGS, Grid
from zsdist.planning.shortest_path import goal_mask
from zsdist.types import Pose, View

START_DISC_M = 1.5  # radius around the start in which the ground counts as free


class EpisodeMemory:
    """Memory of one car over one episode, from which the `Situation` of each step is made.

    Args:
        grid: planning grid.
        pose: pose at the start; the ground within `START_DISC_M` of it counts as free.
        goal: `(x_m, y_m)` of the goal.
        success_radius_m: distance from the goal within which it is reached.
        camera_forward_m: distance of the camera ahead of the car's centre.
        belief: map to go on with; None: an empty one.

    Attributes:
        belief: believed map.
        goals: `(cells, cells)` bool, the cells in which the goal is reached.
        revisits: number of steps into a state that the car had visited before.
        tries: counts of the options that failed.
    """

    def __init__(
        self,
        grid: Grid,
        pose: Pose,
        goal: tuple[float, float],
        success_radius_m: float,
        camera_forward_m: float,
        belief: BeliefMap | None = None,
    ) -> None:
        self._grid, self._goal, self._camera_forward_m = grid, goal, camera_forward_m
        self.goals = goal_mask(grid, goal, success_radius_m)
        self.revisits = 0
        if belief is None:
            belief = BeliefMap(grid)
            belief.clear_disc(pose.x_m, pose.y_m, START_DISC_M)
        self.belief = belief
        self._visits = np.zeros((grid.cells, grid.cells, HEADINGS), np.int32)
        self._block_visits = np.zeros((grid.blocks, grid.blocks), np.int32)
        self.tries = Tries.none(grid)
        self._block: tuple[int, int] | None = None

    def observe(self, pose: Pose, view: View) -> tuple[Situation, Judgement]:
        """Add one view to the belief and one visit to the counts.

        Args:
            pose: pose of the car.
            view: view from this pose.

        Returns:
            The situation, and the shield's judgement of it.

        Raises:
            RunError: a number of the view is not finite.
        """
        for name in ("ray_probabilities", "clearance_m", "advice"):
            finite.require(f"{name} of a picture", getattr(view, name))
        self.belief.update(pose, view, self._camera_forward_m)
        state = self._grid.lattice_state(pose)
        block = self._grid.block_of(state.ix, state.iy)
        self.revisits += bool(self._visits[state.iy, state.ix, state.heading] > 0)
        self._visits[state.iy, state.ix, state.heading] += 1
        if block != self._block:
            self._block_visits[block[1], block[0]] += 1
        self._block = block
        judgement = shield.judge(self.belief, state, self.goals, self._visits)
        situation = Situation(
            grid=self._grid,
            state=state,
            goal=self._goal,
            goals=self.goals,
            advice=view.advice,
            occupied=self.belief.occupied(),
            seen=self.belief.seen(),
            moves=judgement.moves,
            gave_way=judgement.gave_way,
            drive_m=forward_search.path_lengths_from(judgement.moves.blocked, state, path_costs(self._grid)),
            visits=self._visits,
            block_visits=self._block_visits,
            tries=self.tries,
        )
        return situation, judgement
