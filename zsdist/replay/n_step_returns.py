"""Returns over several steps, computed from one-step transitions."""

import numpy as np

_LARGEST = float(np.finfo(np.float32).max)


def n_step(
    steps: int,
    rows: np.ndarray,
    successors: np.ndarray,
    rewards: np.ndarray,
    discounts: np.ndarray,
    usable: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the n-step returns (Sutton 1988) of transitions: each becomes one over up to `steps` transitions.

    To `(s, r_1, gamma_1, s')` the transition that begins in s' is joined: the reward becomes `r_1 + gamma_1 r_2`,
    the discount `gamma_1 gamma_2`, the successor that of the second, and so on. Joining stops where a discount is 0
    (the end of an episode), where no transition begins (the end of a trajectory) and before one that is not usable.
    Actions on the way are taken as recorded: there is no off-policy correction.

    Args:
        steps: most transitions to join, 1 or more.
        rows: `(n,)` int, row of each transition's state among all states, unique.
        successors: `(n,)` int, row of its next state.
        rewards: `(n,)` float32.
        discounts: `(n,)` float32.
        usable: `(n,)` bool, transitions that may be joined.

    Returns:
        `(rewards, discounts, successors)`, `(n,)` each; values of transitions that are not usable have no meaning.
    """
    beginning_at = np.full(max(int(rows.max()), int(successors.max())) + 1, -1)  # transition that begins in each state
    beginning_at[rows[usable]] = np.flatnonzero(usable)
    ends, total, discount = successors.copy(), rewards.astype(np.float64), discounts.astype(np.float64)
    growing = np.flatnonzero(usable)
    for _ in range(steps - 1):
        following = beginning_at[ends[growing]]
        growing, following = (part[(following >= 0) & (discount[growing] > 0)] for part in (growing, following))
        longer = total[growing] + discount[growing] * rewards[following]
        fits = np.abs(longer) <= _LARGEST
        growing, following, longer = growing[fits], following[fits], longer[fits]
        total[growing] = longer
        discount[growing] *= discounts[following]
        ends[growing] = successors[following]
    return total.astype(np.float32), discount.astype(np.float32), ends
