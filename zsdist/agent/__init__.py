"""Algorithm 2: one car's two-level agent, its features, guide policies and shield."""
