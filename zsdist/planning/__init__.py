"""Planning on the grid: frames, footprints, shortest paths, potential fields, rewards and the belief map."""
