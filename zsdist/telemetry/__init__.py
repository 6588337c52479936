"""Statistics of a run for watchers."""
