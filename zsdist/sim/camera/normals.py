"""Numba kernels of surface normals."""

import numpy as np

from zsdist.common.compiled import compiled
from zsdist.sim.camera.kernels import ROWWISE

# Constants in single precision; a Python number in a kernel would be in double precision.
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_EDGE, _SMALL = np.float32(1e-4), np.float32(1e-12)


@compiled(**ROWWISE)
def frustum_normals(
    row: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, nx: np.ndarray, ny: np.ndarray, nz: np.ndarray
) -> None:
    """Write the unit normals of a frustum at points: x and y relative to its position, z above the ground."""
    top, slope = np.float32(row[2] + row[3]) - _EDGE, np.float32((row[5] - row[4]) / row[3])
    for j in range(len(z)):
        square = x[j] * x[j] + y[j] * y[j]
        inverse = _ZERO if z[j] > top else _ONE / np.sqrt(square + slope * slope * square + _SMALL)
        nx[j], ny[j] = x[j] * inverse, y[j] * inverse
    for j in range(len(z)):
        nz[j] = _ONE if z[j] > top else -slope / np.sqrt(_ONE + slope * slope)


@compiled(**ROWWISE)
def ellipsoid_normals(
    row: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, nx: np.ndarray, ny: np.ndarray, nz: np.ndarray
) -> None:
    """Write the unit normals of an ellipsoid; see `frustum_normals`."""
    middle = np.float32(row[2])
    per_x, per_y, per_z = np.float32(row[3] ** -2.0), np.float32(row[4] ** -2.0), np.float32(row[5] ** -2.0)
    for j in range(len(z)):
        gx, gy, gz = x[j] * per_x, y[j] * per_y, (z[j] - middle) * per_z
        inverse = _ONE / np.sqrt(gx * gx + gy * gy + gz * gz + _SMALL)
        nx[j], ny[j] = gx * inverse, gy * inverse
    for j in range(len(z)):
        gx, gy, gz = x[j] * per_x, y[j] * per_y, (z[j] - middle) * per_z
        nz[j] = gz / np.sqrt(gx * gx + gy * gy + gz * gz + _SMALL)


@compiled(**ROWWISE)
def box_normals(
    row: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, nx: np.ndarray, ny: np.ndarray, nz: np.ndarray
) -> None:
    """Write the unit normals of a box, each that of the nearest face; see `frustum_normals`."""
    top, length, width = np.float32(row[2] + row[3]), np.float32(row[4]), np.float32(row[5])
    for j in range(len(z)):
        beyond_x, beyond_y = abs(x[j]) - length, abs(y[j]) - width
        nz[j] = _ONE if z[j] - top > max(beyond_x, beyond_y) else _ZERO
    for j in range(len(z)):
        along = abs(x[j]) - length > abs(y[j]) - width
        side = _ONE - nz[j]
        nx[j] = (side if x[j] > _ZERO else -side) if along else _ZERO
        ny[j] = _ZERO if along else (side if y[j] > _ZERO else -side)
