"""A ring of transitions by column, with uniform sampling or sampling by priority.

State and successor lie side by side in each row. Sharing the states between rows would save nothing where it matters:
a trajectory of one transition has two states, so a ring of shared states needs the same bound, and indices besides.
States are half floats, as they travel both ways. 20,000 rows of 120 features are 10 MiB.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np

from zsdist.common import half_precision
from zsdist.errors import RunError
from zsdist.replay import n_step_returns
from zsdist.replay.priorities import RowPriorities
from zsdist.types import NO_GUIDE, Behaviour, StoredBatch, Trajectories, Trajectory, count_transitions

# Why a transition is refused, in the order in which it is looked for; each counts under the first that applies.
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
    """The newest `capacity` transitions. Insert and sample cost what they move, never the capacity.

    Args:
        state_size: features of a state, `D`.
        actions: number of actions, `A`.
        capacity: transitions held at most.
        n_step: transitions of a trajectory that are stored as one return, at most (`zsdist.replay.n_step_returns`).
        priorities: of `capacity` rows, by which they are drawn; None: uniformly.
    """

    def __init__(
        self, state_size: int, actions: int, capacity: int, n_step: int = 1, priorities: RowPriorities | None = None
    ) -> None:
        self._state_size, self._actions, self._n_step = state_size, actions, n_step
        self._priorities = priorities
        self._columns = _allocate(state_size, actions, capacity)
        self.capacity = capacity
        self._size = 0
        self._head = 0  # row that is written next
        self._written = 0
        self._newest_version = 0

    def __len__(self) -> int:
        return self._size

    @property
    def nbytes(self) -> int:
        """Bytes of all columns at full capacity: `capacity * row_bytes(...)`."""
        return sum(column.nbytes for column in self._columns.values())

    @property
    def oldest_version(self) -> int | None:
        """Weight version that chose the oldest stored transition; None: nothing is stored."""
        return int(self._columns["versions"][(self._head - self._size) % self.capacity]) if self._size else None

    @property
    def oldest_age_versions(self) -> int | None:
        """Weight versions between the newest transition seen and the oldest stored one; None: nothing is stored."""
        return self._newest_version - self.oldest_version if self._size else None

    def insert(self, trajectories: Sequence[Trajectory]) -> tuple[int, dict[str, int]]:
        """Stores the sound transitions of `trajectories`, in order, evicting the oldest.

        Returns:
            `(stored, rejected)`: how many were stored, and how many were refused by reason (`REASONS`), together the
            number offered. Trajectories of other shapes or dtypes than the buffer's are all refused together; states
            may be float32 as well, and are rounded.
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
        sound, rejected = self._judge(offer)
        chosen = np.flatnonzero(sound)
        stored = len(chosen)
        if self._n_step > 1 and stored:
            offer = offer.joined(self._n_step, sound)
        self._write(offer, chosen[-self.capacity :])
        return stored, rejected

    def sample(self, rng: np.random.Generator, batch_size: int, batches: int = 1) -> StoredBatch:
        """Stored transitions, drawn uniformly and independently, or by priority with weights and serials.

        Columns are of the dtypes in which they are held and travel; `zsdist.wire.codec` gives the learner its own.

        Args:
            rng: where chance comes from.
            batch_size: transitions of a batch.
            batches: how many to draw; they come as one, one after the other.

        Raises:
            ValueError: nothing is stored.
        """
        if not self._size:
            raise ValueError("cannot sample from a replay buffer that holds 0 transitions; at least 1 is needed")
        drawn = {}
        if self._priorities is None:
            # Rows 0 to size - 1 are in use, wherever the head is.
            places = rng.integers(0, self._size, batches * batch_size)
        else:
            draws = [self._priorities.draw(rng, batch_size, self._size) for _ in range(batches)]
            places, weights = (np.concatenate(parts) for parts in zip(*draws, strict=True))
            drawn = {"weights": weights, "serials": self._written - 1 - (self._head - 1 - places) % self.capacity}
        taken = {name: column.take(places, axis=0) for name, column in self._columns.items() if name != "versions"}
        return StoredBatch(**taken, **drawn)

    def prioritise(self, serials: np.ndarray, errors: np.ndarray) -> int:
        """Draws rows by new errors from here on; those that were overwritten since are passed over.

        Args:
            serials: `(B,)` int64, of a batch.
            errors: `(B,)` float32, finite and 0 or more.

        Returns:
            How many rows it concerned.
        """
        ages = self._written - 1 - serials
        held = (ages >= 0) & (ages < self._size)
        if self._priorities is not None and held.any():
            self._priorities.update((self._head - 1 - ages[held]) % self.capacity, errors[held])
        return int(np.count_nonzero(held))

    @property
    def written(self) -> int:
        """Rows written in all; the serial of a row is how many were written before it."""
        return self._written

    def resize(self, capacity: int) -> None:
        """Changes the capacity, keeping the newest transitions that fit."""
        kept = min(self._size, capacity)
        places = (self._head - kept + np.arange(kept)) % self.capacity
        columns = _allocate(self._state_size, self._actions, capacity)
        for name, column in self._columns.items():
            columns[name][:kept] = column[places]
        if self._priorities is not None:
            self._priorities.moved(capacity, self._priorities.of(places))
        self._columns, self.capacity, self._size, self._head = columns, capacity, kept, kept % capacity

    def state(self) -> dict[str, np.ndarray]:
        """Everything stored, in place, so that a restored buffer gives the same samples to the same generator."""
        return {name: column[: self._size].copy() for name, column in self._columns.items()} | self.layout()

    def layout(self) -> dict[str, np.ndarray]:
        """What of the `state` is not rows; a piece of them each is told by `newest`."""
        arrays = {
            "capacity": np.array(self.capacity, np.int64),
            "head": np.array(self._head, np.int64),
            "written": np.array(self._written, np.int64),
        }
        if self._priorities is not None:
            arrays["priorities"] = self._priorities.of(np.arange(self._size))
            arrays["largest_priority"] = np.array(self._priorities.largest)
        return arrays

    def newest(self, since: int) -> dict[str, np.ndarray]:
        """The stored rows that were written as number `since` or later, oldest first."""
        count = min(self._size, self._written - since)
        first = (self._head - count) % self.capacity
        parts = (slice(first, first + count), slice(0, max(0, first + count - self.capacity)))
        return {name: np.concatenate([column[part] for part in parts]) for name, column in self._columns.items()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Takes over a `state()`; one without priorities too, whose rows then are as if they had come just now.

        Raises:
            RunError: an entry is missing, or belongs to a buffer of other shapes.
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
        self._columns, self.capacity, self._size, self._head = columns, capacity, size, head
        self._written = int(state["written"])
        self._newest_version = int(columns["versions"][:size].max(initial=0))
        if self._priorities is not None:
            self._priorities.largest = float(state.get("largest_priority", 1.0))
            self._priorities.moved(capacity, state.get("priorities", np.full(size, self._priorities.largest)))

    def check_valid(self) -> None:
        """Asserts what always holds of what is stored; for tests, after any operation."""
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
        rows = offered + len(trajectories)
        shapes = {"states": (rows, self._state_size), "masks": (rows, self._actions)}
        for name, dtype in _DTYPES.items():
            column = trajectories.columns[name]
            if column.shape != shapes.get(name, (offered,)):
                return "shape"
            if column.dtype != dtype:
                return "dtype"
        return None

    def _judge(self, offer: "_Offer") -> tuple[np.ndarray, dict[str, int]]:
        """Which transitions to store, `(n,)` bool, and how many of the others were refused by reason."""
        columns, masks = offer.columns, offer.masks[offer.rows]
        own, a = np.arange(len(offer.rows)), self._actions
        actions, guides, discounts = columns["actions"], columns["guides"], columns["discounts"]
        finite = half_precision.finite_rows(offer.states)
        guided = (guides >= 0) & (guides < a) & masks[own, np.clip(guides, 0, a - 1)]
        checks = {
            "successor": offer.known,
            "state": finite[offer.rows] & finite[offer.successors],
            "reward": np.isfinite(columns["rewards"]),
            "discount": (discounts >= 0) & (discounts <= 1),
            "action": actions < a,
            "action_masked": masks[own, np.minimum(actions, a - 1)],
            "guide": guided | (guides == NO_GUIDE),
            "behaviour": columns["behaviours"] < len(Behaviour),
            "dead_end": offer.masks.any(axis=1)[offer.successors] | (discounts == 0),  # nothing to bootstrap from
        }
        sound, rejected = np.ones(len(offer.rows), bool), {}
        for reason, holds in checks.items():
            refused = int(np.count_nonzero(sound & ~holds))
            if refused:
                rejected[reason] = refused
            sound &= holds
        return sound, rejected

    def _write(self, offer: "_Offer", chosen: np.ndarray) -> None:
        """Copies chosen transitions, no more than the capacity, to where the head is, around the end if need be."""
        written = 0
        while written < len(chosen):
            part = chosen[written : written + self.capacity - self._head]
            place = slice(self._head, self._head + len(part))
            for name, source, index in (
                ("states", offer.states, offer.rows[part]),
                ("next_states", offer.states, offer.successors[part]),
                ("masks", offer.masks, offer.rows[part]),
                ("next_masks", offer.masks, offer.successors[part]),
                *((name, offer.columns[name], part) for name in ("actions", "rewards", "discounts", "guides")),
                ("versions", offer.versions, part),
            ):
                source.take(index, axis=0, out=self._columns[name][place], mode="clip")  # "raise" would copy twice
            if self._priorities is not None:
                self._priorities.written(np.arange(place.start, place.stop))
            written += len(part)
            self._head = place.stop % self.capacity
        self._size = min(self._size + len(chosen), self.capacity)
        self._written += len(chosen)
        if len(chosen):
            self._newest_version = max(self._newest_version, int(offer.versions[chosen].max()))


class _Offer(NamedTuple):
    """Trajectories one after the other: `n` transitions in all, and a state more for each trajectory.

    `rows` and `successors`, `(n,)`, are a transition's two rows among all states; where its successor is not `known`
    it is some other state.
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
        """Well-formed trajectories, with what tells whose transitions are whose."""
        lengths = trajectories.lengths
        ends = lengths.cumsum()
        before = np.arange(len(lengths))  # each trajectory before this one has one more state than transitions
        joined = dict(trajectories.columns)
        steps = joined.pop("successors")
        known = steps <= lengths.repeat(lengths)
        return cls(
            states=joined.pop("states"),
            masks=joined.pop("masks"),
            rows=np.arange(ends[-1]) + before.repeat(lengths),
            successors=np.where(known, steps, 0) + (ends - lengths + before).repeat(lengths),
            known=known,
            versions=trajectories.versions.repeat(lengths),
            columns=joined,
        )

    def joined(self, steps: int, sound: np.ndarray) -> Self:
        """The same with rewards, discounts and successors over up to `steps` sound transitions."""
        rewards, discounts, successors = n_step_returns.n_step(
            steps, self.rows, self.successors, self.columns["rewards"], self.columns["discounts"], sound
        )
        columns = self.columns | {"rewards": rewards, "discounts": discounts}
        return self._replace(columns=columns, successors=successors)


def row_bytes(state_size: int, actions: int) -> int:
    """Bytes one stored transition takes."""
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
