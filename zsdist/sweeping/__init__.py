"""Sweeps: several configurations and seeds, each trained and evaluated in processes of its own, and one table."""
