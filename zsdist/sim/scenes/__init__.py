"""Scenes as pure data: the scene file, kinds of obstacles, families drawn from seeds, and who may see which."""
