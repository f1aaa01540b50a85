"""Compiled loops of `coarsen`: arrays and scalars only; the tests have a numpy twin."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def count_cells(subs, cell_x, cell_y, cell_z, lower, count):
    """Count the fine voxels (n, 3) in every cell of a block; returns the place of each one's cell in it, (n,).

    cell_x, cell_y, cell_z : coarse index of every fine one, by axis.  lower : (3,) coarse index of the block's corner.
    count : (bx, by, bz) int32 zeros, out.
    """
    _, by, bz = count.shape
    flat = count.reshape(-1)
    place = np.empty(subs.shape[0], dtype=np.int64)
    for i in range(subs.shape[0]):
        x, y, z = cell_x[subs[i, 0]] - lower[0], cell_y[subs[i, 1]] - lower[1], cell_z[subs[i, 2]] - lower[2]
        place[i] = (x * by + y) * bz + z
        flat[place[i]] += 1
    return place


@njit(cache=True, nogil=True)
def number_full_cells(count, room_x, room_y, room_z, lower, ny, nz, row, voxels):
    """Number the cells of a block that are at least half full, in ascending order; returns how many they are.

    room_x, room_y, room_z : fine voxels that each coarse index holds, by axis.  lower : as of count_cells.
    ny, nz : shape of the coarse grid.  row : (bx, by, bz) int32 out, -1 = not half full.
    voxels : out, their linear indices in the coarse grid.
    """
    n = 0
    for x in range(count.shape[0]):
        for y in range(count.shape[1]):
            room = room_x[x + lower[0]] * room_y[y + lower[1]]
            for z in range(count.shape[2]):
                row[x, y, z] = -1
                if count[x, y, z] > 0 and 2 * count[x, y, z] >= room * room_z[z + lower[2]]:
                    row[x, y, z] = n
                    voxels[n] = ((x + lower[0]) * ny + y + lower[1]) * nz + z + lower[2]
                    n += 1
    return n


@njit(cache=True, nogil=True)
def rows_of_fine(subs, place, lower, ratio, row, row_of):
    """Row of the cell of every fine voxel; of those in an empty cell that of the occupied neighbour nearest by.

    subs : (n, 3).  place, lower : as of count_cells.  ratio : fine side / coarse side.  row : (bx, by, bz).
    row_of : (n,) int64 out, -1 = no occupied neighbour.
    """
    bx, by, bz = row.shape
    flat = row.reshape(-1)
    for i in range(subs.shape[0]):
        row_of[i] = flat[place[i]]
        if row_of[i] >= 0:
            continue
        x0 = place[i] // (by * bz)
        y0 = place[i] // bz - x0 * by
        z0 = place[i] - (x0 * by + y0) * bz
        best = np.inf
        for x in range(x0 - 1, x0 + 2):
            for y in range(y0 - 1, y0 + 2):
                for z in range(z0 - 1, z0 + 2):
                    if not (0 <= x < bx and 0 <= y < by and 0 <= z < bz) or row[x, y, z] < 0:
                        continue
                    dx = x + lower[0] + 0.5 - (subs[i, 0] + 0.5) * ratio
                    dy = y + lower[1] + 0.5 - (subs[i, 1] + 0.5) * ratio
                    dz = z + lower[2] + 0.5 - (subs[i, 2] + 0.5) * ratio
                    gap = math.sqrt(dx * dx + dy * dy + dz * dz)
                    if gap < best:
                        best = gap
                        row_of[i] = row[x, y, z]


@njit(cache=True, nogil=True)
def mean_colours(place, row, rgb, known, total, n_coloured):
    """Sum of the colours of the fine voxels in each occupied cell, (M, 3) int64, and how many there are, (M,) int64.

    place : as of count_cells.  row : (bx, by, bz).  rgb : (n, 3) uint8.  known : (n,) bool.
    """
    flat = row.reshape(-1)
    for i in range(place.shape[0]):
        k = flat[place[i]]
        if known[i] and k >= 0:
            n_coloured[k] += 1
            for c in range(3):
                total[k, c] += rgb[i, c]
