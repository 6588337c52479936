"""Ring buffer of transitions by column, with uniform sampling or sampling by priority.

Each row holds a state and the next state. Sharing states between rows would not lower the memory bound: a trajectory
of one transition has two states, so a ring of shared states needs as many of them, plus indices. States are half
floats, the format in which they are sent. 20,000 rows of 120 features take 10 MiB.
"""

import weakref
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np

from zsdist.common import half_precision
from zsdist.errors import RunError
from zsdist.replay import n_step_returns
from zsdist.replay.priorities import RowPriorities
from zsdist.replay.ring_copy import RingCopy
from zsdist.types import NO_GUIDE, Behaviour, StoredBatch, Trajectories, Trajectory, count_transitions

# Reasons to reject a transition, in the order of the checks; each transition counts under the first that applies.
REASONS = (
    "shape",
    "dtype",
    "successor",
    "state",
    "reward",
    "discount",
    "action",
    "action_masked",
    "guide",
    "behaviour",
    "dead_end",
)
_DTYPES = {
    "states": np.dtype(np.float16),
    "actions": np.dtype(np.uint8),
    "rewards": np.dtype(np.float32),
    "discounts": np.dtype(np.float32),
    "successors": np.dtype(np.uint16),
    "masks": np.dtype(np.bool_),
    "guides": np.dtype(np.int8),
    "behaviours": np.dtype(np.uint8),
}


class RingBuffer:
    """Ring of the newest `capacity` transitions. The cost of insertion and sampling does not depend on the capacity.

    Args:
        state_size: features of a state, `D`.
        actions: number of actions, `A`.
        capacity: most transitions held at once.
        n_step: most transitions of a trajectory that one stored return covers (`zsdist.replay.n_step_returns`).
        priorities: priorities of `capacity` rows, to sample by; None: uniform sampling.
    """

    def __init__(
        self, state_size: int, actions: int, capacity: int, n_step: int = 1, priorities: RowPriorities | None = None
    ) -> None:
        self._state_size, self._actions, self._n_step = state_size, actions, n_step
        self._priorities = priorities
        self._columns = _allocate(state_size, actions, capacity)
        self.capacity = capacity
        self._size = 0
        self._head = 0  # row to write next
        self._written = 0
        self._newest_version = 0
        self._copy: tuple[weakref.ref[RingCopy], int] | None = None  # newest one, and the rows written before it

    def __len__(self) -> int:
        return self._size

    @property
    def nbytes(self) -> int:
        """Bytes of all columns at full capacity: `capacity * row_bytes(...)`."""
        return sum(column.nbytes for column in self._columns.values())

    @property
    def oldest_version(self) -> int | None:
        """Version of the weights that acted in the oldest transition held; None: nothing is held."""
        return int(self._columns["versions"][(self._head - self._size) % self.capacity]) if self._size else None

    @property
    def oldest_age_versions(self) -> int | None:
        """Weight versions from the oldest transition held to the newest ever stored; None: nothing is held."""
        oldest = self.oldest_version
        return None if oldest is None else self._newest_version - oldest

    def insert(self, trajectories: Sequence[Trajectory]) -> tuple[int, dict[str, int]]:
        """Store the valid transitions of `trajectories`, in order; they overwrite the oldest.

        Returns:
            `(stored, rejected)`: the number stored, and the numbers rejected by reason (`REASONS`). Their sum is the
            number offered. If any shape or dtype differs from the buffer's, all are rejected, except that float32
            states are accepted and rounded.
        """
        offered = count_transitions(trajectories)
        if not offered:
            return 0, {}
        joined = trajectories if isinstance(trajectories, Trajectories) else Trajectories.join(trajectories)
        if joined.columns["states"].dtype == np.float32:
            joined = replace(
                joined, columns=joined.columns | {"states": half_precision.to_half(joined.columns["states"])}
            )
        if reason := self._malformed(joined, offered):
            return 0, {reason: offered}
        offer = _Offer.of(joined)
        valid, rejected = self._validate(offer)
        accepted = np.flatnonzero(valid)
        stored = len(accepted)
        if self._n_step > 1 and stored:
            offer = offer.with_n_step_returns(self._n_step, valid)
        self._write(offer, accepted[-self.capacity :])
        return stored, rejected

    def sample(self, rng: np.random.Generator, batch_size: int, batches: int = 1) -> StoredBatch:
        """Sample stored transitions uniformly with replacement, or by priority with weights and serials.

        Args:
            rng: source of randomness.
            batch_size: transitions of a batch.
            batches: number of batches to draw; they are returned concatenated.

        Raises:
            ValueError: nothing is stored.
        """
        if not self._size:
            raise ValueError("cannot sample from a replay buffer that holds 0 transitions; at least 1 is needed")
        drawn = {}
        if self._priorities is None:
            # Rows 0 to size - 1 are in use, whatever the head.
            rows = rng.integers(0, self._size, batches * batch_size)
        else:
            draws = [self._priorities.draw(rng, batch_size, self._size) for _ in range(batches)]
            rows, weights = (np.concatenate(parts) for parts in zip(*draws, strict=True))
            drawn = {"weights": weights, "serials": self._written - 1 - (self._head - 1 - rows) % self.capacity}
        sampled = {name: column.take(rows, axis=0) for name, column in self._columns.items() if name != "versions"}
        return StoredBatch(**sampled, **drawn)

    def update_priorities(self, serials: np.ndarray, errors: np.ndarray) -> int:
        """Set the priorities of rows from new errors; rows that were overwritten since are skipped.

        Args:
            serials: `(B,)` int64, serials of a sampled batch.
            errors: `(B,)` float32, absolute temporal-difference errors, finite.

        Returns:
            The number of rows that are still held.
        """
        ages = self._written - 1 - serials
        held = (ages >= 0) & (ages < self._size)
        if self._priorities is not None and held.any():
            self._priorities.update((self._head - 1 - ages[held]) % self.capacity, errors[held])
        return int(np.count_nonzero(held))

    @property
    def written(self) -> int:
        """Number of rows written so far; the serial of a row is the number of rows written before it."""
        return self._written

    def resize(self, capacity: int) -> None:
        """Change the capacity; the newest transitions that fit are kept."""
        kept = min(self._size, capacity)
        rows = (self._head - kept + np.arange(kept)) % self.capacity
        columns = _allocate(self._state_size, self._actions, capacity)
        for name, column in self._columns.items():
            columns[name][:kept] = column[rows]
        if self._priorities is not None:
            self._priorities.resize(capacity, self._priorities.get(rows))
        self._columns, self.capacity, self._size, self._head = columns, capacity, kept, kept % capacity
        self._copy = None  # its columns are written no more

    def state(self) -> dict[str, np.ndarray]:
        """Return a copy of all rows in ring order; a restored buffer draws the same rows with an equal generator."""
        return {name: column[: self._size].copy() for name, column in self._columns.items()} | self.layout()

    def begin_copy(self) -> RingCopy:
        """Return a copy of `state` that is made in slices while rows are added; the one before must be done."""
        copy = RingCopy(self._columns, self._size, (self._head - self._size) % self.capacity, self.layout())
        self._copy = weakref.ref(copy), self._written
        return copy

    def layout(self) -> dict[str, np.ndarray]:
        """Return `state` without the rows; `rows_since` returns the rows piece by piece."""
        arrays = {
            "capacity": np.array(self.capacity, np.int64),
            "head": np.array(self._head, np.int64),
            "written": np.array(self._written, np.int64),
        }
        if self._priorities is not None:
            arrays["priorities"] = self._priorities.get(np.arange(self._size))
            arrays["largest_priority"] = np.array(self._priorities.largest)
        return arrays

    def rows_since(self, serial: int) -> dict[str, np.ndarray]:
        """Return a copy of the stored rows with this serial or a later one, oldest first."""
        count = min(self._size, self._written - serial)
        first = (self._head - count) % self.capacity
        parts = (slice(first, first + count), slice(0, max(0, first + count - self.capacity)))
        return {name: np.concatenate([column[part] for part in parts]) for name, column in self._columns.items()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Restore what `state` returned; rows of a state without priorities get the priority of new rows.

        Raises:
            RunError: an entry is missing or belongs to a buffer of other shapes.
        """
        missing = sorted({*self._columns, "capacity", "head", "written"} - set(state))
        if missing:
            raise RunError(f"replay state lacks {', '.join(missing)}")
        capacity, head, size = int(state["capacity"]), int(state["head"]), len(state["actions"])
        if not (size <= capacity and 0 <= head < capacity and (size == capacity or head == size)):
            raise RunError(f"replay state has capacity {capacity}, head {head}, {size} rows; they disagree")
        columns = _allocate(self._state_size, self._actions, capacity)
        for name, column in columns.items():
            found = state[name]
            if found.dtype != column.dtype or found.shape != (size, *column.shape[1:]):
                raise RunError(
                    f"replay state {name} is {found.dtype} of shape {found.shape}; "
                    f"allowed is {column.dtype} of shape {(size, *column.shape[1:])}"
                )
            column[:size] = found
        self._columns, self.capacity, self._size, self._head, self._copy = columns, capacity, size, head, None
        self._written = int(state["written"])
        self._newest_version = int(columns["versions"][:size].max(initial=0))
        if self._priorities is not None:
            self._priorities.largest = float(state.get("largest_priority", 1.0))
            self._priorities.resize(capacity, state.get("priorities", np.full(size, self._priorities.largest)))

    def check_valid(self) -> None:
        """Assert the invariants of the stored rows; for tests, after any operation."""
        columns = {name: column[: self._size] for name, column in self._columns.items()}
        assert 0 <= self._size <= self.capacity
        assert 0 <= self._head < self.capacity
        assert self._size == self.capacity or self._head == self._size
        assert all(len(column) == self.capacity for column in self._columns.values())
        assert self.nbytes == self.capacity * row_bytes(self._state_size, self._actions)
        for name in ("states", "next_states", "rewards", "discounts"):
            assert np.isfinite(columns[name].astype(np.float32)).all(), name
        assert columns["masks"][np.arange(self._size), columns["actions"]].all()
        assert (columns["next_masks"].any(axis=1) | (columns["discounts"] == 0)).all()

    def _malformed(self, trajectories: Trajectories, offered: int) -> str | None:
        """Return the reason to reject all transitions; None: shapes and dtypes are correct."""
        rows = offered + len(trajectories)
        shapes = {"states": (rows, self._state_size), "masks": (rows, self._actions)}
        for name, dtype in _DTYPES.items():
            column = trajectories.columns[name]
            if column.shape != shapes.get(name, (offered,)):
                return "shape"
            if column.dtype != dtype:
                return "dtype"
        return None

    def _validate(self, offer: "_Offer") -> tuple[np.ndarray, dict[str, int]]:
        """Return a mask of the valid transitions, `(n,)` bool, and the numbers of the others by reason."""
        columns, masks = offer.columns, offer.masks[offer.rows]
        each, a = np.arange(len(offer.rows)), self._actions
        actions, guides, discounts = columns["actions"], columns["guides"], columns["discounts"]
        finite = half_precision.finite_rows(offer.states)
        guided = (guides >= 0) & (guides < a) & masks[each, np.clip(guides, 0, a - 1)]
        has_action = np.asarray(offer.masks.any(axis=1))
        checks: dict[str, np.ndarray] = {
            "successor": offer.known,
            "state": finite[offer.rows] & finite[offer.successors],
            "reward": np.isfinite(columns["rewards"]),
            "discount": (discounts >= 0) & (discounts <= 1),
            "action": actions < a,
            "action_masked": masks[each, np.minimum(actions, a - 1)],
            "guide": guided | (guides == NO_GUIDE),
            "behaviour": columns["behaviours"] < len(Behaviour),
            "dead_end": has_action[offer.successors] | (discounts == 0),  # else nothing to bootstrap from
        }
        valid, rejected = np.ones(len(offer.rows), bool), {}
        for reason, holds in checks.items():
            failed = int(np.count_nonzero(valid & ~holds))
            if failed:
                rejected[reason] = failed
            valid &= holds
        return valid, rejected

    def _write(self, offer: "_Offer", accepted: np.ndarray) -> None:
        """Write the accepted transitions, at most the capacity, from the head on, and from row 0 after the last row."""
        if self._copy is not None:
            copy, before = self._copy
            if (ring_copy := copy()) is not None:
                ring_copy.keep_ahead(self._written - before + len(accepted))
        written = 0
        while written < len(accepted):
            part = accepted[written : written + self.capacity - self._head]
            span = slice(self._head, self._head + len(part))
            for name, source, index in (
                ("states", offer.states, offer.rows[part]),
                ("next_states", offer.states, offer.successors[part]),
                ("masks", offer.masks, offer.rows[part]),
                ("next_masks", offer.masks, offer.successors[part]),
                *((name, offer.columns[name], part) for name in ("actions", "rewards", "discounts", "guides")),
                ("versions", offer.versions, part),
            ):
                source.take(index, axis=0, out=self._columns[name][span], mode="clip")  # "raise" would copy twice
            if self._priorities is not None:
                self._priorities.add(span.start, span.stop)
            written += len(part)
            self._head = span.stop % self.capacity
        self._size = min(self._size + len(accepted), self.capacity)
        self._written += len(accepted)
        if len(accepted):
            self._newest_version = max(self._newest_version, int(offer.versions[accepted].max()))


class _Offer(NamedTuple):
    """Joined trajectories of `n` transitions; each trajectory has one state more than transitions.

    Attributes:
        states: `(n + k, D)` float16, of all `k` trajectories.
        masks: `(n + k, A)` bool, actions allowed in each state.
        rows: `(n,)` int64, row of each transition's state among all states.
        successors: `(n,)` int64, row of the transition's next state; arbitrary if it is not `known`.
        known: `(n,)` bool, whether the successor lies within the trajectory.
        versions: `(n,)` int64, version of the weights that acted.
        columns: the other columns of `Trajectory`, `(n,)` each.
    """

    states: np.ndarray
    masks: np.ndarray
    rows: np.ndarray
    successors: np.ndarray
    known: np.ndarray
    versions: np.ndarray
    columns: dict[str, np.ndarray]

    @classmethod
    def of(cls, trajectories: Trajectories) -> Self:
        """Return well-formed trajectories with the rows of each transition's states among all states."""
        lengths = trajectories.lengths
        ends = lengths.cumsum()
        before = np.arange(len(lengths))  # each trajectory before this one has one more state than transitions
        columns = dict(trajectories.columns)
        steps = columns.pop("successors")
        known = steps <= lengths.repeat(lengths)
        return cls(
            states=columns.pop("states"),
            masks=columns.pop("masks"),
            rows=np.arange(ends[-1]) + before.repeat(lengths),
            successors=np.where(known, steps, 0) + (ends - lengths + before).repeat(lengths),
            known=known,
            versions=trajectories.versions.repeat(lengths),
            columns=columns,
        )

    def with_n_step_returns(self, steps: int, valid: np.ndarray) -> Self:
        """Return these transitions with rewards, discounts and successors that span up to `steps` valid transitions."""
        rewards, discounts, successors = n_step_returns.n_step(
            steps, self.rows, self.successors, self.columns["rewards"], self.columns["discounts"], valid
        )
        columns = self.columns | {"rewards": rewards, "discounts": discounts}
        return self._replace(columns=columns, successors=successors)


def row_bytes(state_size: int, actions: int) -> int:
    """Return the bytes of one stored transition."""
    return sum(column.nbytes for column in _allocate(state_size, actions, 1).values())


def _allocate(state_size: int, actions: int, capacity: int) -> dict[str, np.ndarray]:
    return {
        "states": np.empty((capacity, state_size), np.float16),
        "actions": np.empty(capacity, np.uint8),
        "rewards": np.empty(capacity, np.float32),
        "discounts": np.empty(capacity, np.float32),
        "next_states": np.empty((capacity, state_size), np.float16),
        "next_masks": np.empty((capacity, actions), np.bool_),
        "masks": np.empty((capacity, actions), np.bool_),
        "guides": np.empty(capacity, np.int8),
        "versions": np.empty(capacity, np.int64),
    }
