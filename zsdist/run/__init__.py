"""Where roles live: the composition root, the two runners, and the run directory."""
