"""Replay memory of one level: ring buffer, priorities, adaptive sizes, journal, and the limit on updates per insert."""
