"""Train with a change to the algorithm, here Munchausen Q-learning at both levels, and with the original beside it.

Usage: `python examples/custom_algorithm.py [--episodes 60] [--out runs/custom-algorithm]`. OUT is a new folder.

A run makes the learner of each level by `RunSpec.make_dqn`. A subclass of `FusedDqnLearner` that changes the batch
before an update, as here, changes rewards or weights. `BaseDqnLearner` names what a learner of one's own has to do.
Other parts are edited where they are: exploration in `zsdist/agent/epsilon_greedy.py`, losses in
`zsdist/dqn/losses.py`, the guides in `zsdist/agent/guide.py`, rewards in `zsdist/agent/reward_shaping.py`.
"""

import argparse
import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from zsdist import config
from zsdist.agent import features
from zsdist.config import Config
from zsdist.dqn import network
from zsdist.dqn.base import BaseDqnLearner
from zsdist.dqn.fused import FusedDqnLearner
from zsdist.evaluate import find_policy
from zsdist.evaluation.report import Trial, evaluate_all
from zsdist.roles.shapes import SHAPES, learner_seed, level_settings
from zsdist.run import opening, program, training
from zsdist.types import Batch, Level

SHARE, TEMPERATURE, LEAST = 0.9, 0.03, -1.0  # as in the paper of Munchausen DQN (arXiv:2007.14430)


class MunchausenLearner(FusedDqnLearner):
    """Learner that adds to each reward the scaled logarithm of the probability with which its policy takes the action.

    The policy is the softmax of the target network's values, over the allowed actions.
    """

    def update(self, batch: Batch) -> None:
        """See `BaseDqnLearner.update`."""
        values = np.where(batch.masks, network.apply(self.target_parameters(), batch.states), -np.inf)
        advantages = values - values.max(axis=1, keepdims=True)
        logarithms = advantages - TEMPERATURE * np.log(np.exp(advantages / TEMPERATURE).sum(axis=1, keepdims=True))
        taken = np.take_along_axis(logarithms, batch.actions[:, None], axis=1)[:, 0]
        bonus = (SHARE * np.clip(taken, LEAST, 0.0)).astype(np.float32)
        super().update(replace(batch, rewards=batch.rewards + bonus))


def munchausen(settings: Config, level: Level) -> BaseDqnLearner:
    """Return the learner of a level, as `program.make_learner` does for the original algorithm."""
    shape, seed = SHAPES[level], learner_seed(settings, level)
    return MunchausenLearner(
        shape.state_size, shape.actions, level_settings(settings, level), seed=seed, mirror=features.mirror(level)
    )


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    """Train with both algorithms and return the success of each in the scenes that it has trained in."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", default="60")
    parser.add_argument("--out", type=Path, default=Path("runs/custom-algorithm"))
    parser.add_argument("--quick", action="store_true", help="a few seconds, to see that it works")
    options = parser.parse_args(arguments)
    changes = ["placement=inline", "transport.kind=memory", f"run.episodes={2 if options.quick else options.episodes}"]
    if options.quick:
        changes += ["vision.network=student", "camera.size_px=128", "sim.max_steps=20", "merge.every_episodes=0"]
        changes += ["low.min_size=16", "high.min_size=1", "replay.batch_initial=16"]
    settings = config.load(None, tuple(changes))
    trials = []
    for name, make_dqn in (("original", program.make_learner), ("munchausen", munchausen)):
        folder = options.out / name
        with contextlib.ExitStack() as held:
            spec = replace(opening.open_new(settings, folder, print, held), make_dqn=make_dqn)
            summary = training.train(spec, lambda: False, lambda transport, now: None)
        print(f"{name}: {summary['learner_updates']} updates in {summary['wall_s']:.0f} s")
        policy = find_policy(str(folder))
        scenes = 1 if options.quick else 10
        trials.append(Trial(name, policy.contender, policy.weights_sha256, "train", scenes))
    found = {}
    for trial, report in zip(trials, evaluate_all(trials, seed=0, workers=1), strict=True):
        found[trial.name] = report.result["success"]
        low, high = report.result["confidence_95"]["success"]
        print(f"{trial.name:12} success {found[trial.name]:.2f} ({low:.2f}-{high:.2f})")
    print(f"runs: {options.out}; curves: zsdist report {options.out}/*")
    return found


if __name__ == "__main__":
    main()
