"""Driving of a robot: following one action by velocities within limits, and the rules that stop it."""
