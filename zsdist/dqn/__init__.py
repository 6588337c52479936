"""Deep Q-learning on arrays: network, losses, learners and exploration, independent of level, grid and simulator."""
