"""Train the DQN of Stable-Baselines3 for some minutes, and print its success beside zsdist's on the same scenes.

Usage: `python examples/sb3_dqn.py [--minutes 10] [--ours runs/NAME] [--image-px 64]`, after
`pip install 'zsdist[examples]'`. Without `--image-px` it learns from pose and goal alone, which is many times as fast.
`--ours` names the policy beside it, by default the one that comes with the package; this makes one that has trained
as long: `timeout -s INT 600 python -m zsdist.launch --single-process --run-dir runs/NAME`.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import FlattenObservation, RescaleObservation, TransformReward
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback

import zsdist  # registers the environment
from zsdist.evaluation.statistics import wilson_95
from zsdist.sim.scenes import families
from zsdist.sim.scenes.scene import Scene


def make_env(options: argparse.Namespace) -> gymnasium.Env:
    """Return the environment with observations and rewards of about the size of 1, as networks like them."""
    config = {"camera": {"size_px": options.image_px or 64}, "sim": {"max_steps": options.max_steps}}
    env = gymnasium.make(
        "zsdist/CarNavigation-v0", family=options.family, config=config, images=options.image_px is not None
    )
    if options.image_px is None:
        env = RescaleObservation(FlattenObservation(env), np.float64(-1), np.float64(1))
    return TransformReward(env, lambda reward: reward / 100)


def successes(
    act: Callable[[Any], int], env: gymnasium.Env, scenes: Sequence[Scene], begin: Callable[[], None] = lambda: None
) -> int:
    """Return the number of scenes in which a policy reaches the goal; `begin` is called before each."""
    reached = 0
    for scene in scenes:
        begin()
        observation, info = env.reset(options={"scene": scene})
        over = False
        while not over:
            observation, _, terminated, truncated, info = env.step(act(observation))
            over = terminated or truncated
        reached += info["success"]
    return reached


class Clock(BaseCallback):
    """End of the training by time. Exploration falls from 1 to 0.05 during its first half."""

    def __init__(self, minutes: float) -> None:
        super().__init__()
        self.begun_s, self.length_s = time.monotonic(), 60 * minutes

    def share(self) -> float:
        """Return the share of the time that has passed."""
        return (time.monotonic() - self.begun_s) / self.length_s

    def _on_step(self) -> bool:
        return self.share() < 1


def main(arguments: Sequence[str] | None = None) -> tuple[int, int]:
    """Train, and return the successes of Stable-Baselines3's policy and of ours."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--family", default="singleton", help="family of scenes to train in and to drive in")
    parser.add_argument("--scenes", type=int, default=10, help="scenes to drive in at the end")
    parser.add_argument("--max-steps", type=int, default=500, help="actions of an episode")
    parser.add_argument("--image-px", type=int, help="side of the images, 36 or more (default: no images)")
    parser.add_argument("--ours", default="pretrained", help="policy to compare with: pretrained, or a run directory")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="a few seconds, to see that it works")
    options = parser.parse_args(arguments)
    if options.quick:
        options.minutes, options.scenes, options.max_steps = 0.02, 1, 20
    clock, used_s = Clock(options.minutes), time.process_time()
    env = make_env(options)
    model = DQN(
        "MlpPolicy" if options.image_px is None else "MultiInputPolicy",
        env,
        learning_starts=100 if options.quick else 1000,
        buffer_size=10_000 if options.image_px else 100_000,
        target_update_interval=1000,
        seed=options.seed,
        device="cpu",
    )
    model.exploration_schedule = lambda _: max(0.05, 1 - 2 * clock.share())  # its own counts steps, which are unknown
    model.learn(10**9, callback=clock)
    print(
        f"Stable-Baselines3 DQN: {model.num_timesteps} steps in {options.minutes:g} minutes, "
        f"{(time.process_time() - used_s) / 60:.1f} minutes of processor"
    )
    scenes = [families.draw(options.family, "test", index) for index in range(options.scenes)]
    theirs = successes(lambda observation: int(model.predict(observation, deterministic=True)[0]), env, scenes)
    env.close()

    policy = zsdist.load_policy(options.ours)
    env = gymnasium.make("zsdist/CarNavigation-v0", config=policy.config, max_episode_steps=options.max_steps)
    ours = successes(policy.act, env, scenes, policy.reset)
    env.close()
    for name, reached in (("Stable-Baselines3 DQN", theirs), (f"zsdist, {options.ours}", ours)):
        low, high = wilson_95(reached, len(scenes))
        print(f"{name:28} {reached} of {len(scenes)} scenes, 95% {low:.2f} to {high:.2f}")
    return theirs, ours


if __name__ == "__main__":
    main()
