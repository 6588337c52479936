"""Replay role: ring buffers, limiters and journals of both levels in one process."""
