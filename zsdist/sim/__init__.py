"""Simulated world: scenes and their families, physics, cameras and the gymnasium environment."""
