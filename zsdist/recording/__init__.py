"""Recordings of drives: MCAP files that are whole after a kill, sets of episodes, and their export to Minari."""
