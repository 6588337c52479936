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
    """Return n-step transitions (Sutton 1988): each one-step transition is extended to span up to `steps` of them.

    A transition `(s, r_1, gamma_1, s')` is joined with the one that begins in s'. The reward becomes
    `r_1 + gamma_1 r_2`, the discount `gamma_1 gamma_2`, and the successor is the second one's; and so on. Joining stops
    where a discount is 0 (the end of an episode), where no transition begins (the end of a trajectory), and before a
    transition that is not usable. There is no off-policy correction for the actions in between.

    Args:
        steps: most transitions to join, at least 1.
        rows: `(n,)` int, row of each transition's state among all states, unique.
        successors: `(n,)` int, row of each transition's next state.
        rewards: `(n,)` float32, one-step rewards.
        discounts: `(n,)` float32, one-step discounts.
        usable: `(n,)` bool, transitions that may be joined.

    Returns:
        `(rewards, discounts, successors)`, `(n,)` each; values of transitions that are not usable have no meaning.
    """
    beginning_at = np.full(max(int(rows.max()), int(successors.max())) + 1, -1)  # transition that begins in each state
    beginning_at[rows[usable]] = np.flatnonzero(usable)
    ends, total, discount = successors.copy(), rewards.astype(np.float64), discounts.astype(np.float64)
    growing = np.flatnonzero(usable)
    for _ in range(steps - 1):
        if not len(growing):
            break
        following = beginning_at[ends[growing]]
        growing, following = (part[(following >= 0) & (discount[growing] > 0)] for part in (growing, following))
        longer = total[growing] + discount[growing] * rewards[following]
        fits = np.abs(longer) <= _LARGEST
        growing, following, longer = growing[fits], following[fits], longer[fits]
        total[growing] = longer
        discount[growing] *= discounts[following]
        ends[growing] = successors[following]
    return total.astype(np.float32), discount.astype(np.float32), ends
