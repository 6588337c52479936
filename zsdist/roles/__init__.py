"""Roles: single-threaded objects whose `step(now)` never blocks; they own their state and speak only through a transport."""
