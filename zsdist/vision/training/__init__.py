"""How the networks of the visual-act model are trained (Algorithm 1); torch."""
