"""Compiled searches of `zsdist.sim.maps.cover`: largest rectangles, and sums of weights within shapes.

A sample `[row, column]` of an array has its centre at `(column + 0.5, row + 0.5)`.
"""

import math

import numpy as np

from zsdist.common.compiled import compiled


@compiled()
def best_rectangle(allowed: np.ndarray, totals: np.ndarray) -> tuple[float, int, int, int, int]:
    """Return the upright rectangle of allowed samples with the greatest sum of weights.

    Only rectangles that cannot grow on any side are compared.

    Args:
        allowed: `(rows, columns)` bool.
        totals: `(rows + 1, columns + 1)` float64, sums of the weights above and to the left of each corner.

    Returns:
        The sum, and the rectangle as first and last-plus-one row and column; a sum of 0 if there is none above it.
    """
    rows, columns = allowed.shape
    heights = np.zeros(columns + 1, np.int64)
    lefts, tops = np.empty(columns + 1, np.int64), np.empty(columns + 1, np.int64)
    best, found = 0.0, (0, 0, 0, 0)
    for row in range(rows):
        depth = 0
        for column in range(columns + 1):
            height = 0
            if column < columns and allowed[row, column]:
                height = heights[column] + 1
                heights[column] = height
            elif column < columns:
                heights[column] = 0
            left = column
            while depth > 0 and tops[depth - 1] > height:
                depth -= 1
                left = lefts[depth]
                first = row + 1 - tops[depth]
                total = totals[row + 1, column] - totals[first, column] - totals[row + 1, left] + totals[first, left]
                if total > best:
                    best, found = total, (first, row + 1, left, column)
            if height > 0 and (depth == 0 or tops[depth - 1] < height):
                lefts[depth], tops[depth] = left, height
                depth += 1
    return best, found[0], found[1], found[2], found[3]


@compiled()
def sum_in_disc(weights: np.ndarray, x: float, y: float, radius: float) -> float:
    """Return the sum of the weights of the samples within a disc."""
    rows, columns = weights.shape
    total = 0.0
    for row in range(max(int(y - radius - 0.5), 0), min(int(y + radius + 0.5) + 1, rows)):
        across = radius * radius - (row + 0.5 - y) ** 2
        if across < 0.0:
            continue
        half = math.sqrt(across)
        for column in range(max(math.ceil(x - half - 0.5), 0), min(math.floor(x + half - 0.5) + 1, columns)):
            total += weights[row, column]
    return total


@compiled()
def sum_in_box(weights: np.ndarray, x: float, y: float, half_l: float, half_w: float, angle: float) -> float:
    """Return the sum of the weights of the samples within a turned box."""
    rows, columns = weights.shape
    cos, sin = math.cos(angle), math.sin(angle)
    high = abs(sin) * half_l + abs(cos) * half_w
    total = 0.0
    for row in range(max(int(y - high - 0.5), 0), min(int(y + high + 0.5) + 1, rows)):
        low, most = row_of_box(row + 0.5 - y, cos, sin, half_l, half_w)
        for column in range(max(math.ceil(x + low - 0.5), 0), min(math.floor(x + most - 0.5) + 1, columns)):
            total += weights[row, column]
    return total


@compiled()
def row_of_box(dy: float, cos: float, sin: float, half_l: float, half_w: float) -> tuple[float, float]:
    """Return where a row at `dy` from a box's centre enters and leaves the box, from its centre; empty if turned."""
    low, most = -1e18, 1e18
    for a, b, half in ((cos, sin, half_l), (-sin, cos, half_w)):  # |a dx + b dy| <= half
        if abs(a) < 1e-9:
            if abs(b * dy) > half:
                return 1.0, -1.0
            continue
        one, other = (-half - b * dy) / a, (half - b * dy) / a
        low, most = max(low, min(one, other)), min(most, max(one, other))
    return low, most


@compiled()
def mark_disc(marks: np.ndarray, x: float, y: float, radius: float, step: int) -> None:
    """Add `step` to the samples within a disc."""
    rows, columns = marks.shape
    for row in range(max(int(y - radius - 0.5), 0), min(int(y + radius + 0.5) + 1, rows)):
        across = radius * radius - (row + 0.5 - y) ** 2
        if across < 0.0:
            continue
        half = math.sqrt(across)
        for column in range(max(math.ceil(x - half - 0.5), 0), min(math.floor(x + half - 0.5) + 1, columns)):
            marks[row, column] += step


@compiled()
def mark_box(marks: np.ndarray, x: float, y: float, half_l: float, half_w: float, angle: float, step: int) -> None:
    """Add `step` to the samples within a turned box."""
    rows, columns = marks.shape
    cos, sin = math.cos(angle), math.sin(angle)
    high = abs(sin) * half_l + abs(cos) * half_w
    for row in range(max(int(y - high - 0.5), 0), min(int(y + high + 0.5) + 1, rows)):
        low, most = row_of_box(row + 0.5 - y, cos, sin, half_l, half_w)
        for column in range(max(math.ceil(x + low - 0.5), 0), min(math.floor(x + most - 0.5) + 1, columns)):
            marks[row, column] += step
