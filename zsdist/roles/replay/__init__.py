"""Replay role: one process of rings, limiters and journals for both levels."""
