"""Returns over several steps, made from transitions of one step."""

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
    """What each transition becomes when up to `steps` of them are taken as one: n-step returns (Sutton 1988).

    From `(s, r_1, gamma_1, s')` on, the transition that begins in s' is joined: the reward becomes `r_1 + gamma_1 r_2`,
    the discount `gamma_1 gamma_2`, the successor that of the second, and so on. Joining stops where a discount is 0
    (the end of an episode), where no transition begins (the end of a trajectory) and before one that is not usable.
    What was done on the way is taken as it was: there is no correction for the policy having changed since.

    Args:
        steps: joined at most, 1 or more.
        rows: `(n,)` int, row of each transition's state among all states; no two are equal.
        successors: `(n,)` int, row of the state that follows.
        rewards: `(n,)` float32.
        discounts: `(n,)` float32.
        usable: `(n,)` bool, transitions that others may be joined with.

    Returns:
        `(rewards, discounts, successors)`, `(n,)` each; those of transitions that are not usable mean nothing.
    """
    begins = np.full(max(int(rows.max()), int(successors.max())) + 1, -1)
    begins[rows[usable]] = np.flatnonzero(usable)
    ends, total, left = successors.copy(), rewards.astype(np.float64), discounts.astype(np.float64)
    going = np.flatnonzero(usable)
    for _ in range(steps - 1):
        following = begins[ends[going]]
        going, following = (part[(following >= 0) & (left[going] > 0)] for part in (going, following))
        more = total[going] + left[going] * rewards[following]
        fits = np.abs(more) <= _LARGEST
        going, following, more = going[fits], following[fits], more[fits]
        total[going] = more
        left[going] *= discounts[following]
        ends[going] = successors[following]
    return total.astype(np.float32), left.astype(np.float32), ends
