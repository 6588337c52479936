"""Replay memory of one level: a ring of transitions, its adaptive size, and the ratio of updates to inserts."""
