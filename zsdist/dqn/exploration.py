"""Exploration rate of the actors."""


def epsilon(finished_episodes: int, decay: float, minimum: float) -> float:
    """Return the probability of an exploratory action: `decay ** finished_episodes`, at least `minimum` (Table 2)."""
    return max(minimum, decay**finished_episodes)
