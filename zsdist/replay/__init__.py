"""Replay memory of one level: ring buffer, priorities, adaptive sizes, journal, and limit on updates per insert."""
