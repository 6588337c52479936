"""Scheduler role: leases, merges, checkpoints and the end of a run."""
