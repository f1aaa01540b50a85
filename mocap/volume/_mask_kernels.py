"""Compiled loops over whole masks, (H, W) uint8 of 0 and 1. Arrays and scalars only; numpy twins are in the tests.

Sums and unions of bytes are cast back to bytes, so that the compiler works on many pixels at once.
"""

from __future__ import annotations

import numpy as np
from numba import njit

CELL_PX = 4  # side of a cell: its rows are words of four bytes


@njit(cache=True, nogil=True)
def rectangle_of(mask):
    """u0, u1, v0, v1, inclusive, around the foreground; 0, -1, 0, -1 where there is none."""
    height, width = mask.shape
    columns = np.zeros(width, dtype=np.uint8)
    v0, v1 = height, -1
    for v in range(height):
        row = mask[v]
        some = np.uint8(0)
        for u in range(width):
            some = np.uint8(some | row[u])
        if some != 0:
            v0, v1 = min(v0, v), v
            for u in range(width):
                columns[u] = np.uint8(columns[u] | row[u])
    if v1 < 0:
        return 0, -1, 0, -1
    u0, u1 = 0, width - 1
    while columns[u0] == 0:
        u0 += 1
    while columns[u1] == 0:
        u1 -= 1
    return u0, u1, v0, v1


@njit(cache=True, nogil=True)
def count_in_cells(mask, counts):
    """Pixels of the foreground in cells of 4 x 4; those that hang over the picture's edge are left out.

    counts : (at least H // 4, at least W // 4) uint8, changed where there are cells.
    """
    n = mask.shape[1] // CELL_PX
    columns = np.empty(n * CELL_PX, dtype=np.uint8)
    words = columns.view(np.uint32)
    for j in range(mask.shape[0] // CELL_PX):
        v = CELL_PX * j
        a, b, c, d = mask[v], mask[v + 1], mask[v + 2], mask[v + 3]
        for u in range(columns.shape[0]):
            columns[u] = np.uint8(np.uint8(a[u] + b[u]) + np.uint8(c[u] + d[u]))
        own = counts[j]
        for i in range(n):
            # The highest byte of the product is the sum of all four.
            own[i] = np.uint8((words[i] * np.uint32(0x01010101)) >> np.uint32(24))


@njit(cache=True, nogil=True)
def copy_foreground(mask, own, rectangle):
    """Make `own` (H, W) equal to a mask. rectangle : (4,) int64 around the foreground of `own`, in and out."""
    for v in range(rectangle[2], rectangle[3] + 1):
        out = own[v, rectangle[0] : rectangle[1] + 1]
        for i in range(out.shape[0]):
            out[i] = 0
    u0, u1, v0, v1 = rectangle_of(mask)
    rectangle[0], rectangle[1], rectangle[2], rectangle[3] = u0, u1, v0, v1
    for v in range(v0, v1 + 1):
        row, out = mask[v, u0 : u1 + 1], own[v, u0 : u1 + 1]
        for i in range(row.shape[0]):
            out[i] = row[i]
