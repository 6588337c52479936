"""Path planning by zero-shot vision and hierarchical reinforcement learning, trained by actors and learners."""

__version__ = "0.1.0"
