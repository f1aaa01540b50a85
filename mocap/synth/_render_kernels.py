"""Kernel of the light maps: points to texels and depths."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def project_to_map(
    points: NDArray[np.float32],
    R: NDArray[np.float32],
    t: NDArray[np.float32],
    scale: NDArray[np.float32],
    offset: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Texel coordinates, (-99, -99) behind the light, and squared distances of points."""
    n = len(points)
    texel = np.empty((n, 2), dtype=np.float32)
    square = np.empty(n, dtype=np.float32)
    for i in range(n):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        x = a * R[0, 0] + b * R[0, 1] + c * R[0, 2] - t[0]
        y = a * R[1, 0] + b * R[1, 1] + c * R[1, 2] - t[1]
        z = a * R[2, 0] + b * R[2, 1] + c * R[2, 2] - t[2]
        square[i] = x * x + y * y + z * z
        if z > np.float32(1e-3):
            texel[i, 0] = x * scale[0] / z + offset[0]
            texel[i, 1] = y * scale[1] / z + offset[1]
        else:
            texel[i, 0] = texel[i, 1] = np.float32(-99)
    return texel, square
