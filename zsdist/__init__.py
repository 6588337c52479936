"""Visual navigation of a car by zero-shot vision and hierarchical reinforcement learning, trained on many processes."""

from zsdist.common import search_path  # noqa: F401 (first: it decides where the other imports are found)

# isort: split
import gymnasium

__version__ = "0.1.0"

gymnasium.register(id="zsdist/CarNavigation-v0", entry_point="zsdist.sim.env:CarNavigation")
