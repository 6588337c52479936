"""Pictures with labels for pretraining, drawn from the simulated world."""
