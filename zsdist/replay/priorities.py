"""Proportional prioritisation of a ring's rows: Schaul et al., Prioritized Experience Replay (2016).

Deviation: the exponent of the importance weights is constant; in the paper it grows to 1 over training.
"""

import numpy as np

SMALLEST_ERROR = 1e-3  # added to every error, so that every row can be drawn again
_SMALLEST_WEIGHT = float(np.finfo(np.float32).tiny)  # so that no weight is rounded to 0


class SumTree:
    """Binary tree of the sums of `size` numbers, initially 0. To find or set one costs the depth of the tree."""

    def __init__(self, size: int) -> None:
        self._leaves = 1 << max(size - 1, 0).bit_length()
        self._sums = np.zeros(2 * self._leaves)  # node k has the children 2k and 2k + 1; 1 is the root

    @property
    def total(self) -> float:
        """Sum of all numbers."""
        return float(self._sums[1])

    def __getitem__(self, index: np.ndarray) -> np.ndarray:
        numbers: np.ndarray = self._sums[self._leaves + index]
        return numbers

    def __setitem__(self, index: np.ndarray, values: np.ndarray | float) -> None:
        """Set numbers to values of 0 or more; the last of several values for one index counts."""
        nodes = self._leaves + index
        self._sums[nodes] = values
        while len(nodes) and nodes[0] > 1:  # all nodes are equally deep
            nodes = np.unique(nodes >> 1)
            self._sums[nodes] = self._sums[2 * nodes] + self._sums[2 * nodes + 1]

    def fill(self, start: int, stop: int, value: float) -> None:
        """Set the numbers from `start` to below `stop` to one value; neighbours share most of their sums."""
        first, last = self._leaves + start, self._leaves + stop - 1
        self._sums[first : last + 1] = value
        while first > 1:
            first, last = first >> 1, last >> 1
            pairs = self._sums[2 * first : 2 * last + 2]
            self._sums[first : last + 1] = pairs[::2] + pairs[1::2]

    def find(self, masses: np.ndarray) -> np.ndarray:
        """Return the index of the number into which each mass falls, with the numbers laid end to end, `(B,)` int64.

        Args:
            masses: `(B,)` float64 from 0 to below `total`, which must not be 0.
        """
        nodes, remaining = np.ones(len(masses), np.int64), masses.copy()
        while nodes[0] < self._leaves:
            nodes *= 2
            left = self._sums[nodes]
            # A rounding error at the very end must not lead to a number of 0.
            right = (remaining >= left) & (self._sums[nodes + 1] > 0)
            remaining -= np.where(right, left, 0.0)
            nodes += right
        return nodes - self._leaves


class RowPriorities:
    """Priorities of a ring's rows; the probability that a row is drawn is proportional to its priority.

    The priority of a row is `(|error| + SMALLEST_ERROR) ** exponent`, with its error in the last update that used it.
    Before its first update, it is the largest priority so far.

    Args:
        capacity: number of rows.
        exponent: the paper's alpha, 0 (uniform) to 1 (proportional to the error).
        importance: the paper's beta, the share of the sampling bias that the weights correct, 0 (nothing) to 1 (all).

    Attributes:
        largest: largest priority so far.
    """

    def __init__(self, capacity: int, exponent: float, importance: float) -> None:
        self._exponent, self._importance = exponent, importance
        self._tree = SumTree(capacity)
        self.largest = 1.0

    def add(self, start: int, stop: int) -> None:
        """Give the rows from `start` to below `stop`, which hold new transitions, the largest priority so far."""
        self._tree.fill(start, stop, self.largest)

    def draw(self, rng: np.random.Generator, count: int, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Draw one row from each of `count` equal parts of the total priority.

        Args:
            rng: source of randomness.
            count: rows to draw, `B`.
            size: number of rows in use.

        Returns:
            Rows `(B,)` int64 and importance weights `(B,)` float32: `(size * probability) ** -importance`, scaled so
            that the largest is 1.
        """
        total = self._tree.total
        rows = self._tree.find((np.arange(count) + rng.random(count)) * (total / count))
        weights = (size * self._tree[rows] / total) ** -self._importance
        return rows, np.maximum(weights / weights.max(), _SMALLEST_WEIGHT).astype(np.float32)

    def update(self, rows: np.ndarray, errors: np.ndarray) -> None:
        """Set the priorities of rows from their errors, `(B,)`, finite and 0 or more."""
        priorities = (errors.astype(np.float64) + SMALLEST_ERROR) ** self._exponent
        self._tree[rows] = priorities
        self.largest = max(self.largest, float(priorities.max(initial=0.0)))

    def get(self, rows: np.ndarray) -> np.ndarray:
        """Return the priorities of rows, `(n,)` float64."""
        return self._tree[rows]

    def resize(self, capacity: int, priorities: np.ndarray) -> None:
        """Change the capacity; the first rows get these priorities, the others 0."""
        self._tree = SumTree(capacity)
        self._tree[np.arange(len(priorities))] = priorities
