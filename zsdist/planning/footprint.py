"""Where the car's body sweeps: one table for shield, planner, solvability check and shortest paths."""

CAR_LENGTH_M = 2.04  # cabinet and wheels (Table 1 and the wheels' overhang)
CAR_WIDTH_M = 1.09
MARGIN_M = 0.10
