"""Deep Q-learning in one file, in the style of CleanRL: torch and the environment, nothing else of zsdist.

Usage: `python examples/cleanrl_dqn.py [--steps 50000] [--family singleton]`. It learns from pose and goal alone,
masks actions that lead off the grid, and prints its success in the family's scenes.
"""

import argparse
import random
from collections.abc import Sequence

import gymnasium
import numpy as np
import torch
from torch import nn


class QNetwork(nn.Module):
    """Values of the five actions of a state of five numbers."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(5, 120), nn.ReLU(), nn.Linear(120, 84), nn.ReLU(), nn.Linear(84, 5))

    def forward(self, states: torch.Tensor) -> torch.Tensor:
        """Return the values, `(B, 5)`."""
        return self.layers(states)


def state_of(observation: dict[str, np.ndarray]) -> np.ndarray:
    """Return position and heading, and the way to the goal, scaled to about -1 to 1, `(5,)` float32."""
    x_m, y_m, heading_rad = observation["pose"]
    to_goal = observation["goal"] - observation["pose"][:2]
    return np.array([x_m / 12.5, y_m / 12.5, heading_rad / np.pi, *(to_goal / 25.0)], np.float32)


def greedy(network: QNetwork, state: np.ndarray, mask: np.ndarray) -> int:
    """Return the allowed action with the highest value."""
    with torch.no_grad():
        values = network(torch.from_numpy(state)[None])[0].numpy()
    return int(np.where(mask, values, -np.inf).argmax())


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, drive greedily, and return the share of successes."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--steps", type=int, default=50_000)
    add("--family", default="singleton")
    add("--drives", type=int, default=10, help="greedy drives at the end")
    add("--max-steps", type=int, default=500, help="actions of an episode")
    add("--seed", type=int, default=0)
    add("--buffer", type=int, default=50_000)
    add("--batch", type=int, default=128)
    add("--discount", type=float, default=0.98)
    add("--learning-rate", type=float, default=5e-4)
    add("--begin", type=int, default=1000, help="step at which learning begins")
    add("--quick", action="store_true", help="a few seconds, to see that it works")
    args = parser.parse_args(arguments)
    if args.quick:
        args.steps, args.begin, args.drives, args.max_steps = 150, 50, 1, 20

    random.seed(args.seed)
    torch.manual_seed(args.seed)
    rng = np.random.default_rng(args.seed)
    config = {"sim": {"max_steps": args.max_steps}}
    env = gymnasium.make("zsdist:zsdist/CarNavigation-v0", family=args.family, config=config, images=False)
    online, target = QNetwork(), QNetwork()
    target.load_state_dict(online.state_dict())
    optimiser = torch.optim.Adam(online.parameters(), lr=args.learning_rate)
    memory: list[tuple[np.ndarray, int, float, np.ndarray, np.ndarray, bool]] = []
    outcomes: list[bool] = []

    observation, info = env.reset(seed=args.seed)
    state, mask = state_of(observation), info["action_mask"].astype(bool)
    for step in range(args.steps):
        epsilon = max(0.05, 1 - 2 * step / args.steps)
        explores = rng.random() < epsilon
        action = int(rng.choice(np.flatnonzero(mask))) if explores else greedy(online, state, mask)
        observation, reward, terminated, truncated, info = env.step(action)
        after, mask = state_of(observation), info["action_mask"].astype(bool)
        transition = (state, action, reward / 100, after, mask, terminated)
        if len(memory) < args.buffer:
            memory.append(transition)
        else:
            memory[step % args.buffer] = transition
        state = after
        if terminated or truncated:
            outcomes.append(info["success"])
            observation, info = env.reset()
            state, mask = state_of(observation), info["action_mask"].astype(bool)
            if len(outcomes) % 50 == 0:
                print(f"step {step}: success {np.mean(outcomes[-50:]):.2f} in the last 50 episodes")
        if step >= args.begin and step % 4 == 0:
            rows = zip(*random.sample(memory, min(args.batch, len(memory))), strict=True)
            states, actions, rewards, afters, masks, ends = (torch.from_numpy(np.array(column)) for column in rows)
            with torch.no_grad():
                best = target(afters).masked_fill(~masks, -torch.inf).max(dim=1).values
                targets = rewards.float() + args.discount * best * ~ends
            values = online(states).gather(1, actions[:, None])[:, 0]
            loss = nn.functional.smooth_l1_loss(values, targets)
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(online.parameters(), 10.0)
            optimiser.step()
            with torch.no_grad():
                for slow, fast in zip(target.parameters(), online.parameters(), strict=True):
                    slow.lerp_(fast, 0.01)

    reached = 0
    for _ in range(args.drives):
        observation, info = env.reset()
        over = False
        while not over:
            action = greedy(online, state_of(observation), info["action_mask"].astype(bool))
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        reached += info["success"]
    env.close()
    print(f"success in {reached} of {args.drives} greedy drives after {args.steps} steps")
    return reached / args.drives


if __name__ == "__main__":
    main()
