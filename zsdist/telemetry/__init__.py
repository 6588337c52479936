"""Statistics of a run, as watchers see them."""
