"""Compiled loops of the occluder maps. Arrays and scalars only; each has a numpy twin in the tests.

A cell is one pixel of a picture reduced to a quarter; cells of a picture are numbered v * width + u.
"""

from __future__ import annotations

import numpy as np
from numba import njit

NO_VOTE, FREE, BLOCKED = 0, 1, 2
_MOST_VOTES = 65535


@njit(cache=True, nogil=True)
def paint_nearest(cell, depth, half, is_painted, beyond, canvas):
    """Smallest depth in every cell, over squares of 2 half + 1 cells around points.

    cell : (N,) int32 of each point, -1 outside the picture.  depth : (N,) m.  half : (N,) int32 cells.  is_painted :
    (N,) bool, which points.  beyond : (h, w) float32 m, nothing nearer counts in a cell.  canvas : (h, w) float32,
    lowered in place.
    """
    height, width = canvas.shape
    for i in range(cell.shape[0]):
        if not is_painted[i] or cell[i] < 0:
            continue
        v, u = cell[i] // width, cell[i] % width
        for b in range(max(v - half[i], 0), min(v + half[i] + 1, height)):
            for a in range(max(u - half[i], 0), min(u + half[i] + 1, width)):
                if beyond[b, a] < depth[i] < canvas[b, a]:
                    canvas[b, a] = depth[i]


@njit(cache=True, nogil=True)
def needed_voxels(cell, half, sees, n_objecting, n_needing, width, first, left, is_needed):
    """Which voxels must be somebody's, because nothing that fewer cameras object to explains the foreground.

    Voxels to which nobody objects are. What they leave of the foreground must be explained by those to which one camera
    objects, where `n_needing` cameras show foreground that is left; and so on.
    cell, half : (C, N) int32, cell of each voxel, and cells to either side of it that it explains.  sees : (C, N) bool,
    whether foreground is there.  n_objecting : (N,) int.  width : (C,) cells of a row.  first : (C + 1,) first
    cell of each camera in `left`.  left : (cells of all cameras,) bool, the foreground; what is explained is taken out
    in place.  is_needed : (N,) bool out.
    """
    n_cameras, n = cell.shape
    for level in range(n_cameras + 1):
        n_more = 0
        for i in range(n):
            if n_objecting[i] < level:
                continue
            n_more += 1
            if n_objecting[i] > level:
                continue
            n_left = 0
            for c in range(n_cameras):
                if sees[c, i] and left[first[c] + cell[c, i]]:
                    n_left += 1
            is_needed[i] = level == 0 or n_left >= n_needing
        for c in range(n_cameras):
            w = width[c]
            height = (first[c + 1] - first[c]) // w
            for i in range(n):
                if n_objecting[i] != level or not is_needed[i] or not sees[c, i]:
                    continue
                v, u, r = cell[c, i] // w, cell[c, i] % w, half[c, i]
                for b in range(max(v - r, 0), min(v + r + 1, height)):
                    for a in range(max(u - r, 0), min(u + r + 1, w)):
                        left[first[c] + b * w + a] = False
        if n_more == 0:
            return


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
