"""Pretraining of the vision model: pictures, training in stages, and a check of the result."""
