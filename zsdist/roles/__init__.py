"""Roles: single-threaded objects whose `step(now)` never blocks and which speak only through a transport."""
