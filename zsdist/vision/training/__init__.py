"""Training of the networks of the visual-act model (Algorithm 1); torch."""
