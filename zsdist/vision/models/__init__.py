"""Networks on the tokens of an encoder, and the small one that needs none; torch."""

STUDENT_PX = 128
"""Side of the pictures that the student takes; it stands here so that whoever runs the student needs no torch."""
