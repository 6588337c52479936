"""Deep Q-learning on arrays: network, losses, learners, exploration. Knows no level, grid, simulator or transport."""
