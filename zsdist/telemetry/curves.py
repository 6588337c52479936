"""Curves of a run for a terminal: its figures over episodes, drawn in dots of braille."""

from collections.abc import Mapping, Sequence

import numpy as np

from zsdist.telemetry.history import is_figure
from zsdist.telemetry.snapshot import Fields

CURVES = {  # figures of `Snapshot.row`, the most telling first
    "recent_success": "success, last 50 episodes",
    "mean_return": "return",
    "env_steps_per_s": "env steps/s",
    "low_loss": "loss low",
    "high_loss": "loss high",
}
MOST_ROWS = 2048
PACE_OVER_S = 600.0  # newest part of a run, from which the time that is left is estimated
_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))  # of the left and right half of a character, from the top


class CurveHistory:
    """Figures of a run since its beginning, thinned out where they are many.

    Args:
        past: columns of `metrics.jsonl` by name, for what was before it is watched.
    """

    def __init__(self, past: Mapping[str, Sequence[float | None]] | None = None) -> None:
        self._rows: list[dict[str, float]] = []
        past = past or {}
        for index in range(len(past.get("time_s", ()))):
            self.add({name: value for name, values in past.items() if (value := values[index]) is not None})

    def add(self, row: Fields) -> None:
        """Note a row of figures, unless no episode has ended since the last one."""
        kept = {name: float(row[name]) for name in ("time_s", "episodes", *CURVES) if is_figure(row.get(name))}
        if not {"time_s", "episodes"} <= set(kept):
            return
        if self._rows and self._rows[-1]["episodes"] >= kept["episodes"]:
            if self._rows[-1]["episodes"] > kept["episodes"]:  # resumed from an earlier checkpoint
                self._rows = [old for old in self._rows if old["episodes"] < kept["episodes"]]
            else:
                return
        self._rows.append(kept)
        if len(self._rows) > MOST_ROWS:
            self._rows = self._rows[::2]

    def points(self, name: str) -> list[tuple[float, float]]:
        """Return the pairs of episodes and a figure, in order."""
        return [(row["episodes"], row[name]) for row in self._rows if name in row]

    def left_s(self, target: float) -> float | None:
        """Return the time until `target` episodes at the newest pace, s; None where there is no pace yet."""
        if not self._rows:
            return None
        last = self._rows[-1]
        first = next(row for row in self._rows if row["time_s"] >= last["time_s"] - PACE_OVER_S)
        driven, took_s = last["episodes"] - first["episodes"], last["time_s"] - first["time_s"]
        return max(0.0, target - last["episodes"]) * took_s / driven if driven >= 2 and took_s > 0 else None


def braille(points: Sequence[tuple[float, float]], columns: int, rows: int) -> list[str]:
    """Return a curve as `rows` texts of `columns` characters, from the top; its ends and extremes fill the room.

    Args:
        points: pairs of x and y, in order of x; at least one.
        columns: width, characters.
        rows: height, characters.
    """
    wide, high = 2 * columns, 4 * rows
    xs, ys = np.array(points, np.float64).T
    values = np.interp(np.linspace(xs[0], xs[-1], wide), xs, ys)
    low, span = values.min(), np.ptp(values)
    heights = np.full(wide, (high - 1) // 2) if span == 0 else np.rint((values - low) / span * (high - 1)).astype(int)
    cells = np.zeros((rows, columns), np.int64)
    before = heights[0]
    for x, y in enumerate(heights.tolist()):
        start, stop = sorted((before, y))
        for dot in range(start, stop + 1):
            row, part = divmod(high - 1 - dot, 4)
            cells[row, x // 2] |= _DOTS[x % 2][part]
        before = y
    return ["".join(chr(0x2800 + code) for code in line) for line in cells.tolist()]
