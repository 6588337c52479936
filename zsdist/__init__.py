"""Path planning by zero-shot vision and hierarchical reinforcement learning, trained by actors and learners."""

import gymnasium

__version__ = "0.1.0"

gymnasium.register(id="zsdist/CarNavigation-v0", entry_point="zsdist.sim.env:CarNavigation")
