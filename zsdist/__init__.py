"""Visual navigation of a car by zero-shot vision and hierarchical reinforcement learning, trained on many processes."""

import gymnasium

__version__ = "0.1.0"

gymnasium.register(id="zsdist/CarNavigation-v0", entry_point="zsdist.sim.env:CarNavigation")
