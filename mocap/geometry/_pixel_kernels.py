"""Pixels of a pinhole picture: where points fall in it, and which places are near them."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def pixels_of_points(points, R, t, K, width, height):
    """Pixels (M, 2), column and row, of those world points (N, 3) that lie in front of a pinhole and in its picture."""
    pixels = np.empty((points.shape[0], 2), dtype=np.int64)
    n = 0
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        depth = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        if depth <= 0.1:
            continue
        u = np.rint(K[0, 0] * (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]) / depth + K[0, 2])
        v = np.rint(K[1, 1] * (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]) / depth + K[1, 2])
        if u >= 0 and v >= 0 and u < width and v < height:
            pixels[n, 0] = u
            pixels[n, 1] = v
            n += 1
    return pixels[:n]


@njit(cache=True, nogil=True)
def are_near(at, pixels, corner, shape, reach):
    """Which places (M, 2) of a crop have one of some pixels (N, 2) of the picture in a square of so many pixels around
    them.  corner, shape : of the crop, column and row, height and width."""
    marked = np.zeros((shape[0], shape[1]), dtype=np.bool_)
    for i in range(pixels.shape[0]):
        col = pixels[i, 0] - corner[0]
        row = pixels[i, 1] - corner[1]
        if 0 <= col < shape[1] and 0 <= row < shape[0]:
            marked[row, col] = True
    found = np.zeros(at.shape[0], dtype=np.bool_)
    for i in range(at.shape[0]):
        for row in range(max(0, at[i, 1] - reach), min(shape[0], at[i, 1] + reach + 1)):
            for col in range(max(0, at[i, 0] - reach), min(shape[1], at[i, 0] + reach + 1)):
                if marked[row, col]:
                    found[i] = True
                    break
            if found[i]:
                break
    return found


@njit(cache=True, nogil=True)
def extent_of(pixels):
    """Smallest and largest column and row of some pixels (N, 2), N > 0: (2,), (2,)."""
    low = pixels[0].copy()
    high = pixels[0].copy()
    for i in range(pixels.shape[0]):
        for c in range(2):
            low[c] = min(low[c], pixels[i, c])
            high[c] = max(high[c], pixels[i, c])
    return low, high
