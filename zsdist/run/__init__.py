"""Composition root of a run, its two runners, and the run directory."""
