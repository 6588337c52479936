"""Conversion of trajectories and batches to columns and back, and checks of such columns.

States are sent as float16: 11 significant bits, magnitudes up to 65504, and values below 6e-8 are rounded to zero. With
every transport, both ends use the rounded values, and a second rounding changes nothing. Rewards and discounts are
float32. Masks are packed, eight to a byte.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from zsdist.common import half_precision
from zsdist.errors import DecodeError
from zsdist.types import NO_GUIDE, Behaviour, Level, StoredBatch, Trajectories, Trajectory

MAX_ACTIONS = 64
MAX_STATE_SIZE = 65_536
MAX_VERSION = 2**62  # upper bound, excluded, of weight versions

Schema = Mapping[str, tuple[np.dtype, int]]  # dtype and number of dimensions by name

TRAJECTORY_COLUMNS: Schema = {
    "states": (np.dtype("float16"), 2),
    "actions": (np.dtype("uint8"), 1),
    "rewards": (np.dtype("float32"), 1),
    "discounts": (np.dtype("float32"), 1),
    "successors": (np.dtype("uint16"), 1),
    "masks": (np.dtype("uint8"), 2),
    "guides": (np.dtype("int8"), 1),
    "behaviours": (np.dtype("uint8"), 1),
    "lengths": (np.dtype("uint16"), 1),
    "versions": (np.dtype("uint64"), 1),
}
BATCH_COLUMNS: Schema = {
    "states": (np.dtype("float16"), 2),
    "actions": (np.dtype("uint8"), 1),
    "rewards": (np.dtype("float32"), 1),
    "discounts": (np.dtype("float32"), 1),
    "next_states": (np.dtype("float16"), 2),
    "next_masks": (np.dtype("uint8"), 2),
    "masks": (np.dtype("uint8"), 2),
    "guides": (np.dtype("int8"), 1),
}

PRIORITISED_BATCH_COLUMNS: Schema = {
    **BATCH_COLUMNS,
    "weights": (np.dtype("float32"), 1),
    "serials": (np.dtype("int64"), 1),
}
PRIORITY_COLUMNS: Schema = {"serials": (np.dtype("int64"), 1), "errors": (np.dtype("float32"), 1)}


def from_trajectories(trajectories: Sequence[Trajectory], level: Level) -> tuple[dict[str, np.ndarray], int]:
    """Return the joined columns of trajectories, and the number of actions; raise `DecodeError` if they are invalid."""
    if not trajectories:
        return {}, 0
    state_size, actions = trajectories[0].states.shape[-1], trajectories[0].masks.shape[-1]
    for trajectory in trajectories:
        rows = len(trajectory) + 1
        if trajectory.level != level:
            raise DecodeError("level", f"a trajectory of level {trajectory.level} in the stream of level {level}")
        if trajectory.states.shape != (rows, state_size) or trajectory.masks.shape != (rows, actions):
            raise DecodeError("shape", f"states {trajectory.states.shape}, masks {trajectory.masks.shape}, {rows=}")
        if rows > np.iinfo(np.uint16).max or not 0 <= trajectory.weight_version < MAX_VERSION:
            raise DecodeError("range", f"{rows - 1} transitions of weight version {trajectory.weight_version}")

    def join(name: str, dtype: type) -> np.ndarray:
        return _to_wire_dtype(np.concatenate([getattr(trajectory, name) for trajectory in trajectories]), name, dtype)

    columns = {
        "states": join("states", np.float16),
        "actions": join("actions", np.uint8),
        "rewards": join("rewards", np.float32),
        "discounts": join("discounts", np.float32),
        "successors": join("successors", np.uint16),
        "masks": np.packbits(join("masks", np.bool_), axis=1),
        "guides": join("guides", np.int8),
        "behaviours": join("behaviours", np.uint8),
        "lengths": np.array([len(trajectory) for trajectory in trajectories], np.uint16),
        "versions": np.array([trajectory.weight_version for trajectory in trajectories], np.uint64),
    }
    return columns, actions


def check_trajectories(columns: Mapping[str, np.ndarray], actions: int) -> int:
    """Return the number of transitions; raise `DecodeError` unless the columns hold valid trajectories."""
    if not columns:
        if actions:
            raise DecodeError("actions", "number of actions without trajectories")
        return 0
    require_columns(columns, TRAJECTORY_COLUMNS)
    lengths = columns["lengths"].astype(np.int64)
    if not len(lengths) or not lengths.all():
        raise DecodeError("lengths", "a trajectory without transitions")
    ends = lengths.cumsum()
    transitions = int(ends[-1])
    rows = transitions + len(lengths)
    expected = dict.fromkeys(columns, transitions) | {"states": rows, "masks": rows}
    _require_rows(columns, expected | {"lengths": len(lengths), "versions": len(lengths)})
    _check_decisions(columns, actions, "states", "masks")
    if columns["versions"].max() >= MAX_VERSION:
        raise DecodeError("range", "weight version")
    if columns["behaviours"].max() > max(Behaviour):
        raise DecodeError("behaviour")
    successors = columns["successors"] + (ends - lengths).repeat(lengths)  # indices among all transitions
    if (successors <= np.arange(transitions)).any() or (successors > ends.repeat(lengths)).any():
        raise DecodeError("successor", "outside its trajectory, or not after its transition")
    if (successors[1:] < successors[:-1]).any():  # successors in the next trajectory are larger anyway
        raise DecodeError("successor", "decreasing")
    return transitions


def to_trajectories(columns: Mapping[str, np.ndarray], actions: int, level: Level) -> Sequence[Trajectory]:
    """Return the trajectories of checked columns; their states stay float16."""
    if not columns:
        return ()
    rows = {name: columns[name] for name in ("actions", "rewards", "discounts", "successors", "guides", "behaviours")}
    rows |= {"states": columns["states"], "masks": _unpack_masks(columns["masks"], actions)}
    return Trajectories(level, rows, columns["lengths"].astype(np.int64), columns["versions"].astype(np.int64))


def from_batch(batch: StoredBatch) -> tuple[dict[str, np.ndarray], int]:
    """Return the columns of a batch and its number of actions; raise `DecodeError` if a dtype or value is invalid."""
    columns = {
        name: _to_wire_dtype(getattr(batch, name), name, dtype.type)
        for name, (dtype, _) in BATCH_COLUMNS.items()
        if "masks" not in name
    }
    for name in ("masks", "next_masks"):
        columns[name] = np.packbits(_to_wire_dtype(getattr(batch, name), name, np.bool_), axis=1)
    if batch.serials is not None:
        assert batch.weights is not None, "a prioritised batch has both"
        columns |= {"weights": batch.weights, "serials": batch.serials}
    return columns, batch.masks.shape[1]


def check_batch(columns: Mapping[str, np.ndarray], actions: int) -> None:
    """Raise `DecodeError` unless the columns are a valid batch of one row or more."""
    prioritised = "serials" in columns
    require_columns(columns, PRIORITISED_BATCH_COLUMNS if prioritised else BATCH_COLUMNS)
    rows = len(columns["actions"])
    if not rows:
        raise DecodeError("lengths", "an empty batch")
    _require_rows(columns, dict.fromkeys(columns, rows))
    if columns["states"].shape != columns["next_states"].shape:
        raise DecodeError("shape", "states and next_states differ")
    _check_decisions(columns, actions, "states", "masks")
    _check_decisions(columns, actions, "next_states", "next_masks")
    if prioritised:
        _check_serials(columns)
        if not (columns["weights"].min() > 0 and columns["weights"].max() <= 1):  # false for NaN
            raise DecodeError("weight", "outside 0 to 1")


def check_priorities(columns: Mapping[str, np.ndarray]) -> None:
    """Raise `DecodeError` unless the columns are valid priorities of one row or more."""
    require_columns(columns, PRIORITY_COLUMNS)
    rows = len(columns["serials"])
    if not rows:
        raise DecodeError("lengths", "no priorities")
    _require_rows(columns, dict.fromkeys(columns, rows))
    _check_serials(columns)
    require_finite(columns["errors"], "errors")
    if columns["errors"].min() < 0:
        raise DecodeError("range", "an error below 0")


def to_batch(columns: Mapping[str, np.ndarray], actions: int) -> StoredBatch:
    """Return the batch of checked columns."""
    return StoredBatch(
        states=columns["states"],
        actions=columns["actions"],
        rewards=columns["rewards"],
        discounts=columns["discounts"],
        next_states=columns["next_states"],
        next_masks=_unpack_masks(columns["next_masks"], actions),
        masks=_unpack_masks(columns["masks"], actions),
        guides=columns["guides"],
        weights=columns.get("weights"),
        serials=columns.get("serials"),
    )


def require_columns(columns: Mapping[str, np.ndarray], schema: Schema) -> None:
    """Raise `DecodeError` unless the columns are exactly those of a schema, with its dtypes and dimensions."""
    if set(columns) != set(schema):
        raise DecodeError("column", ", ".join(sorted(set(columns) ^ set(schema)))[:120])
    for name, (dtype, dimensions) in schema.items():
        if columns[name].dtype != dtype:
            raise DecodeError("dtype", f"column {name!r} is {columns[name].dtype}; allowed is {dtype}")
        if columns[name].ndim != dimensions:
            raise DecodeError("shape", f"column {name!r} has {columns[name].ndim} dimensions; allowed are {dimensions}")


def require_finite(column: np.ndarray, name: str) -> None:
    """Raise `DecodeError` if a float column holds NaN or infinity."""
    if not (half_precision.all_finite(column) if column.dtype == np.float16 else np.isfinite(column).all()):
        largest = np.finfo(column.dtype).max
        raise DecodeError(
            "nonfinite", f"column {name!r} holds NaN or more than {largest:.6g}, the most of {column.dtype}"
        )


def _to_wire_dtype(column: np.ndarray, name: str, dtype: type) -> np.ndarray:
    """Return a column in the dtype it is sent in; raise `DecodeError` if a value changes by more than rounding."""
    if column.dtype == dtype:
        return column
    if not np.issubdtype(dtype, np.floating):
        if column.dtype.kind not in "iu" or dtype == np.bool_:
            raise DecodeError("dtype", f"{name} is {column.dtype}")
        limits = np.iinfo(dtype)
        if column.size and (column.min() < limits.min or column.max() > limits.max):
            raise DecodeError("range", f"{name} holds values outside {limits.min} to {limits.max}")
    elif column.dtype.kind != "f":
        raise DecodeError("dtype", f"{name} is {column.dtype}")
    elif column.dtype == np.float32 and dtype == np.float16:
        return half_precision.to_half(column)
    with np.errstate(over="ignore"):  # an overflow becomes infinite, which is checked later
        return column.astype(dtype)


def _require_rows(columns: Mapping[str, np.ndarray], rows: Mapping[str, int]) -> None:
    for name, column in columns.items():
        if len(column) != rows[name]:
            raise DecodeError("shape", f"column {name!r} has {len(column)} rows; expected are {rows[name]}")


def _check_decisions(columns: Mapping[str, np.ndarray], actions: int, states: str, masks: str) -> None:
    """Check the columns that trajectories and batches have in common."""
    if not 1 <= actions <= MAX_ACTIONS:
        raise DecodeError("actions", f"{actions}; allowed are 1 to {MAX_ACTIONS}")
    if not 1 <= columns[states].shape[1] <= MAX_STATE_SIZE:
        raise DecodeError("shape", f"state size {columns[states].shape[1]}")
    if columns["actions"].max() >= actions:
        raise DecodeError("action", f"{columns['actions'].max()} of {actions}")
    if columns["guides"].min() < NO_GUIDE or columns["guides"].max() >= actions:
        raise DecodeError("guide")
    if columns[masks].shape[1] != -(-actions // 8) or (columns[masks][:, -1] & (0xFF >> ((actions - 1) % 8 + 1))).any():
        raise DecodeError("mask", f"not {actions} bits per row")
    for name in (states, "rewards"):
        require_finite(columns[name], name)
    if not (columns["discounts"].min() >= 0 and columns["discounts"].max() <= 1):  # false for NaN
        raise DecodeError("discount", "outside 0 to 1")


def _check_serials(columns: Mapping[str, np.ndarray]) -> None:
    if columns["serials"].min() < 0:
        raise DecodeError("range", "a serial below 0")


def _unpack_masks(packed: np.ndarray, actions: int) -> np.ndarray:
    return np.unpackbits(packed, axis=1, count=actions).view(np.bool_)
