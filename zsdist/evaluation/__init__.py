"""Greedy episodes, their metrics, and the baselines with which they are compared."""
