"""Planning on the grid: lattice, footprints, shortest paths, potential fields, rewards and the belief map."""
