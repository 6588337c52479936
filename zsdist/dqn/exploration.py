"""How much to explore."""


def epsilon(finished_episodes: int, decay: float, minimum: float) -> float:
    """Probability of an exploratory action: `decay ** finished_episodes`, never below `minimum` (Table 2)."""
    return max(minimum, decay**finished_episodes)
