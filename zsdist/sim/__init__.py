"""The simulated world: scenes and their families, physics, cameras and the gymnasium environment."""

import gymnasium

gymnasium.register(id="zsdist/CarNavigation-v0", entry_point="zsdist.sim.env:CarNavigation")
