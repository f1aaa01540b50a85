"""Compiled loops of the occluder maps. Arrays and scalars only; each has a numpy twin in the tests.

A cell is one pixel of a picture reduced to a quarter; cells of a picture are numbered v * width + u.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NO_VOTE, FREE, BLOCKED = 0, 1, 2
_MOST_VOTES = 65535


@njit(cache=True, nogil=True)
def paint_nearest(uv, depth, half, canvas):
    """Smallest depth in every cell, over squares of 2 half + 1 cells around points.

    uv : (N, 2) cells.  depth, half : (N,) m and cells.  canvas : (h, w) float32, lowered in place. Points with
    NaN or no depth before the camera are skipped.
    """
    height, width = canvas.shape
    for i in range(uv.shape[0]):
        d = depth[i]
        if not d > 0.0 or not math.isfinite(uv[i, 0] + uv[i, 1]):
            continue
        u0 = max(math.ceil(uv[i, 0] - half[i] - 0.5), 0)
        u1 = min(math.floor(uv[i, 0] + half[i] + 0.5), width - 1)
        v0 = max(math.ceil(uv[i, 1] - half[i] - 0.5), 0)
        v1 = min(math.floor(uv[i, 1] + half[i] + 0.5), height - 1)
        for v in range(v0, v1 + 1):
            for u in range(u0, u1 + 1):
                if d < canvas[v, u]:
                    canvas[v, u] = d


@njit(cache=True, nogil=True)
def sort_by_cell(cell, first, rows):
    """Rows of points in the order of their cells: those of cell k are rows[first[k] : first[k + 1]].

    cell : (N,) int32, -1 = in no cell.  first : (n_cells + 1,) int64 out.  rows : (n,) int32 out, n = points in a cell.
    """
    first[:] = 0
    for i in range(cell.shape[0]):
        if cell[i] >= 0:
            first[cell[i] + 1] += 1
    for k in range(first.shape[0] - 1):
        first[k + 1] += first[k]
    at = first[:-1].copy()
    for i in range(cell.shape[0]):
        if cell[i] >= 0:
            rows[at[cell[i]]] = i
            at[cell[i]] += 1


@njit(cache=True, nogil=True)
def vote_along_rays(near, verdict, first, rows, depth, margin, n_free, n_blocked):
    """Votes of one camera in one frame: everything on a cell's ray before the person there is free, or blocks.

    near : (n_cells,) m, depth of the person, inf where there is none.  verdict : (n_cells,) FREE, BLOCKED or NO_VOTE.
    first, rows : the points by cells, of sort_by_cell.  depth : (n,) m, of the points in the order of `rows`.
    margin : m before the person within which nothing is said.  n_free, n_blocked : (N,) uint16, added to.
    """
    for k in range(near.shape[0]):
        if verdict[k] == NO_VOTE:
            continue
        limit = near[k] - margin
        for j in range(first[k], first[k + 1]):
            if depth[j] < limit:
                i = rows[j]
                if verdict[k] == FREE:
                    if n_free[i] < _MOST_VOTES:
                        n_free[i] += np.uint16(1)
                elif n_blocked[i] < _MOST_VOTES:
                    n_blocked[i] += np.uint16(1)


@njit(cache=True, nogil=True)
def hide_pixels(pixels, xs, ys, zs, axis, width, cell_px, map_depth, mark):
    """Mark the pixels of points that lie behind what hides things from a camera.

    pixels : (N,) int32 v * width + u, -1 outside; changed in place.  xs, ys, zs : (N,) m, world.  axis : (4,) third
    row of R, t, so that depth = R[2] . x + t[2].  map_depth : (h, w) m, inf where nothing stands in the way.
    """
    height_cells, width_cells = map_depth.shape
    for i in range(pixels.shape[0]):
        if pixels[i] < 0:
            continue
        v = (pixels[i] // width) // cell_px
        u = (pixels[i] % width) // cell_px
        limit = map_depth[min(v, height_cells - 1), min(u, width_cells - 1)]
        if axis[0] * xs[i] + axis[1] * ys[i] + axis[2] * zs[i] + axis[3] > limit:
            pixels[i] = mark
