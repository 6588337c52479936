"""Algorithm 2: the two-level agent of one car, its features, guide policies, planner, shield and recorder."""
