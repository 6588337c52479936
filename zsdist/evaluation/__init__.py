"""Greedy episodes, their metrics and the baselines they are held against."""
