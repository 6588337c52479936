"""Scenes as pure data: scene files, kinds of obstacles, families drawn from seeds, and the purposes they may serve."""
