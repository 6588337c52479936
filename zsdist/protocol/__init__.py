"""Reliable delivery by numbered frames, windows, acknowledgements and credit, as state machines without I/O."""
