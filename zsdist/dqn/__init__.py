"""Deep Q-learning on arrays: network, losses, learner, exploration; knows no level, grid, simulator or transport."""
