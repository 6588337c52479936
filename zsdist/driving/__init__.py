"""Driving of one episode, for actors and for evaluation."""
