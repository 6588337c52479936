"""Exported policies on a robot: the bundle's files, and the runner that decides. It needs no torch and no simulator."""
