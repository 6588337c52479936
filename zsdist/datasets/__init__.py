"""Labelled pictures for pretraining, drawn from the simulated world."""
