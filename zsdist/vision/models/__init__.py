"""Networks on the tokens of an encoder, and the student network, which needs no encoder; torch."""

STUDENT_PX = 128
"""Side of the pictures that the student takes; defined here so that running the student needs no torch."""
