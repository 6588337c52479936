"""Train MaskablePPO of sb3-contrib, which chooses among the actions that stay on the grid, and print its success.

Usage: `python examples/maskable_ppo.py [--steps 100000] [--family singleton]`, after
`pip install 'zsdist[examples]'`. The environment has `action_masks()`, so nothing has to be wrapped for the masks.
"""

import argparse
from collections.abc import Sequence

import gymnasium
import numpy as np
from gymnasium.wrappers import FlattenObservation, RescaleObservation, TransformReward
from sb3_contrib import MaskablePPO
from stable_baselines3.common.monitor import Monitor


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, drive greedily, and return the share of successes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--family", default="singleton")
    parser.add_argument("--drives", type=int, default=10, help="greedy drives at the end")
    parser.add_argument("--max-steps", type=int, default=500, help="actions of an episode")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="a few seconds, to see that it works")
    options = parser.parse_args(arguments)
    rollout = 1024
    if options.quick:
        options.steps, options.drives, options.max_steps, rollout = 64, 1, 20, 64
    config = {"sim": {"max_steps": options.max_steps}}
    env = gymnasium.make("zsdist:zsdist/CarNavigation-v0", family=options.family, config=config, images=False)
    env = RescaleObservation(FlattenObservation(env), np.float64(-1), np.float64(1))
    env = Monitor(TransformReward(env, lambda reward: reward / 100))
    model = MaskablePPO("MlpPolicy", env, n_steps=rollout, batch_size=64, seed=options.seed, device="cpu")
    model.learn(options.steps)
    reached = 0
    for _ in range(options.drives):
        observation, info = env.reset()
        over = False
        while not over:
            masks = env.unwrapped.action_masks()
            action, _ = model.predict(observation, action_masks=masks, deterministic=True)
            observation, _, terminated, truncated, info = env.step(int(action))
            over = terminated or truncated
        reached += info["success"]
    env.close()
    print(f"MaskablePPO: success in {reached} of {options.drives} greedy drives after {model.num_timesteps} steps")
    return reached / options.drives


if __name__ == "__main__":
    main()
