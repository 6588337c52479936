"""Networks on the tokens of an encoder, and networks that need no encoder; torch.

The sizes of their pictures are defined here, so that running them needs no torch.
"""

STUDENT_PX = 128
"""Side of the pictures that the student takes."""

COMPACT_PX = 160
"""Side of the pictures that the compact network takes: five columns for each ray, the middle one along the ray."""

COMPACT_ROWS = 120
"""Number of rows that the compact network reads, the lowest ones: what obstructs a car stands on the ground."""
