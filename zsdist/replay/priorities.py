"""Proportional prioritisation of a ring's rows: Schaul et al., Prioritized Experience Replay (2016).

Deviation: the exponent of the importance weights stays what it is, where the paper lets it grow to 1 over training.
"""

import numpy as np

SMALLEST_ERROR = 1e-3  # added to every error, so that no row is never drawn again
_SMALLEST_WEIGHT = float(np.finfo(np.float32).tiny)  # none becomes 0


class SumTree:
    """Numbers of `size` places, 0 at first, and a binary tree of their sums: to find or set one costs its depth."""

    def __init__(self, size: int) -> None:
        self._leaves = 1 << max(size - 1, 0).bit_length()
        self._sums = np.zeros(2 * self._leaves)  # node k has the children 2k and 2k + 1; 1 is the root

    @property
    def total(self) -> float:
        """Sum of all."""
        return float(self._sums[1])

    def __getitem__(self, places: np.ndarray) -> np.ndarray:
        return self._sums[self._leaves + places]

    def __setitem__(self, places: np.ndarray, values: np.ndarray | float) -> None:
        """Sets numbers, 0 or more; where a place is named twice the last one counts."""
        nodes = self._leaves + places
        self._sums[nodes] = values
        while len(nodes) and nodes[0] > 1:  # all nodes are equally deep
            nodes = np.unique(nodes >> 1)
            self._sums[nodes] = self._sums[2 * nodes] + self._sums[2 * nodes + 1]

    def find(self, masses: np.ndarray) -> np.ndarray:
        """The place in which each mass falls, `(B,)`, when the numbers are laid end to end.

        Args:
            masses: `(B,)` float64 from 0 to below `total`, which must not be 0.
        """
        nodes, left_over = np.ones(len(masses), np.int64), masses.copy()
        while nodes[0] < self._leaves:
            nodes *= 2
            left = self._sums[nodes]
            # A rounding error at the very end must not lead to where there is nothing.
            right = (left_over >= left) & (self._sums[nodes + 1] > 0)
            left_over -= np.where(right, left, 0.0)
            nodes += right
        return nodes - self._leaves


class RowPriorities:
    """How likely each row of a ring is to be drawn.

    The priority of a row is `(|error| + SMALLEST_ERROR) ** exponent` with its error in the last update that it was part
    of, and the largest so far until then.

    Args:
        capacity: rows.
        exponent: 0 is uniform, 1 in proportion to the error; the paper's alpha.
        importance: how much of the bias this brings the weights make good, from 0 (nothing) to 1 (all); its beta.
    """

    def __init__(self, capacity: int, exponent: float, importance: float) -> None:
        self._exponent, self._importance = exponent, importance
        self._tree = SumTree(capacity)
        self.largest = 1.0

    def written(self, places: np.ndarray) -> None:
        """New transitions stand in these rows."""
        self._tree[places] = self.largest

    def draw(self, rng: np.random.Generator, count: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """`count` rows, one from each of as many equal parts of the whole, and their importance weights.

        Args:
            rng: where chance comes from.
            count: rows to draw, `B`.
            rows: that are in use.

        Returns:
            Places `(B,)` int64 and weights `(B,)` float32: `(rows * probability) ** -importance`, the largest 1.
        """
        total = self._tree.total
        places = self._tree.find((np.arange(count) + rng.random(count)) * (total / count))
        weights = (rows * self._tree[places] / total) ** -self._importance
        return places, np.maximum(weights / weights.max(), _SMALLEST_WEIGHT).astype(np.float32)

    def update(self, places: np.ndarray, errors: np.ndarray) -> None:
        """Takes over errors of rows, `(B,)`, finite and 0 or more."""
        priorities = (errors.astype(np.float64) + SMALLEST_ERROR) ** self._exponent
        self._tree[places] = priorities
        self.largest = max(self.largest, float(priorities.max(initial=0.0)))

    def of(self, places: np.ndarray) -> np.ndarray:
        """Priorities of rows."""
        return self._tree[places]

    def moved(self, capacity: int, priorities: np.ndarray) -> None:
        """The ring has another capacity; its first rows have these priorities, the others none."""
        self._tree = SumTree(capacity)
        self._tree[np.arange(len(priorities))] = priorities
