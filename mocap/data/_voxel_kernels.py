"""Compiled loops on linear indices of voxels."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def subscripts_of(voxels, ny, nz, out):
    """(ix, iy, iz) of linear indices (N,) int32, into out (N, 3) int32."""
    for i in range(voxels.shape[0]):
        # Unsigned: a remainder of signed numbers takes twice as long.
        v = np.uint32(voxels[i])
        column = v // np.uint32(nz)
        ix = column // np.uint32(ny)
        out[i, 0] = ix
        out[i, 1] = column - ix * np.uint32(ny)
        out[i, 2] = v - column * np.uint32(nz)


@njit(cache=True, nogil=True)
def centers_of(voxels, ny, nz, origin, side, out):
    """Centres, m, of linear indices (N,) int32, into out (N, 3)."""
    for i in range(voxels.shape[0]):
        v = np.uint32(voxels[i])
        column = v // np.uint32(nz)
        ix = column // np.uint32(ny)
        out[i, 0] = origin[0] + (np.float64(ix) + 0.5) * side
        out[i, 1] = origin[1] + (np.float64(column - ix * np.uint32(ny)) + 0.5) * side
        out[i, 2] = origin[2] + (np.float64(v - column * np.uint32(nz)) + 0.5) * side
