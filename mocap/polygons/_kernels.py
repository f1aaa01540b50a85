"""Colour histograms of convex polygons by scan lines; the honest twin is `likelihood.polygon_scores_numpy`.

A pixel is one uint16: three colour bins of three bits and a bit for the foreground. Uniform colours come in runs along
a row, so that counting runs instead of pixels needs one comparison per pixel and no histogram access.
"""

from __future__ import annotations

import numpy as np
from numba import njit

N_BINS = 8
_BIN_MASK = 7
_FOREGROUND_SHIFT = 9


@njit(cache=True, nogil=True)
def place_parts(state, needed, parent, offset, rest_angle, first_column, angle_column, frames):
    """Fill frames (P, 5): origin x, y, orientation, its cosine and sine, of the needed parts."""
    for p in range(parent.shape[0]):
        if not needed[p]:
            continue
        c = first_column[p]
        a = angle_column[p]
        q = parent[p]
        if q < 0:
            frames[p, 0] = state[c]
            frames[p, 1] = state[c + 1]
            frames[p, 2] = state[a]
        else:
            ox, oy = offset[p, 0], offset[p, 1]
            if a > c:
                ox += state[c]
                oy += state[c + 1]
            frames[p, 0] = frames[q, 0] + frames[q, 3] * ox - frames[q, 4] * oy
            frames[p, 1] = frames[q, 1] + frames[q, 4] * ox + frames[q, 3] * oy
            frames[p, 2] = frames[q, 2] + rest_angle[p] + state[a]
        frames[p, 3] = np.cos(frames[p, 2])
        frames[p, 4] = np.sin(frames[p, 2])


@njit(cache=True, nogil=True)
def count_polygon(x, y, image, histogram):
    """Add the pixels of a convex polygon to histogram (3 * 8,); returns its area and foreground area in pixels.

    x, y : (C,) finite corners. A pixel belongs to the polygon when its centre does, left and upper border included.
    Pixels outside the image count for the area only.
    """
    n_rows, n_columns = image.shape
    n = x.shape[0]
    low = y.min()
    high = y.max()
    # Far outside: bounded before the cast to an integer. The area then misses rows that no histogram sees anyway.
    first = int(np.ceil(max(low, -1e6)))
    last = int(np.ceil(min(high, 1e6)))
    area = 0
    foreground = 0
    for row in range(first, last):
        left = np.inf
        right = -np.inf
        x0 = x[n - 1]
        y0 = y[n - 1]
        for i in range(n):
            x1 = x[i]
            y1 = y[i]
            if (y0 <= row) != (y1 <= row):
                # From the upper end whatever the edge's sense, so that neighbours round alike.
                if y0 < y1:
                    cut = x0 + (row - y0) / (y1 - y0) * (x1 - x0)
                else:
                    cut = x1 + (row - y1) / (y0 - y1) * (x0 - x1)
                left = min(left, cut)
                right = max(right, cut)
            x0 = x1
            y0 = y1
        if not right > left:
            continue
        start = int(np.ceil(max(left, -1e6)))
        stop = int(np.ceil(min(right, 1e6)))
        area += stop - start
        if row < 0 or row >= n_rows:
            continue
        start = max(start, 0)
        stop = min(stop, n_columns)
        if stop <= start:
            continue
        line = image[row]
        value = line[start]
        run = 0
        for column in range(start, stop):
            if line[column] != value:
                foreground += _add_run(histogram, value, run)
                value = line[column]
                run = 0
            run += 1
        foreground += _add_run(histogram, value, run)
    return area, foreground


@njit(cache=True, nogil=True)
def _add_run(histogram, value, run):
    histogram[value & _BIN_MASK] += run
    histogram[N_BINS + ((value >> 3) & _BIN_MASK)] += run
    histogram[2 * N_BINS + ((value >> 6) & _BIN_MASK)] += run
    return run * (value >> _FOREGROUND_SHIFT)


@njit(cache=True, nogil=True)
def polygon_histograms_kernel(
    states,
    scored,
    needed,
    parent,
    offset,
    rest_angle,
    first_column,
    angle_column,
    corners,
    corner_start,
    image,
    counts,
):
    """Fill counts (N, n_scored, 26) int64: 3 * 8 bins, area, foreground area; -1 where a corner is not finite."""
    frames = np.empty((parent.shape[0], 5))
    most = 0
    for p in range(parent.shape[0]):
        most = max(most, corner_start[p + 1] - corner_start[p])
    x = np.empty(most)
    y = np.empty(most)
    for n in range(states.shape[0]):
        place_parts(states[n], needed, parent, offset, rest_angle, first_column, angle_column, frames)
        for j in range(scored.shape[0]):
            p = scored[j]
            lo = corner_start[p]
            m = corner_start[p + 1] - lo
            is_finite = True
            for i in range(m):
                u = corners[lo + i, 0]
                v = corners[lo + i, 1]
                x[i] = frames[p, 0] + frames[p, 3] * u - frames[p, 4] * v
                y[i] = frames[p, 1] + frames[p, 4] * u + frames[p, 3] * v
                is_finite &= np.isfinite(x[i]) and np.isfinite(y[i])
            own = counts[n, j]
            if not is_finite:
                own[:] = -1
                continue
            own[:] = 0
            area, foreground = count_polygon(x[:m], y[:m], image, own)
            own[3 * N_BINS] = area
            own[3 * N_BINS + 1] = foreground


@njit(cache=True, nogil=True)
def polygon_scores_kernel(
    states,
    scored,
    needed,
    parent,
    offset,
    rest_angle,
    first_column,
    angle_column,
    corners,
    corner_start,
    image,
    sqrt_reference,
    squared_distance,
    uncovered,
):
    """Fill squared_distance and uncovered (N, n_scored): Bhattacharyya d^2 and the share of pixels off the foreground.

    sqrt_reference : (P, 24), square roots of the reference histograms, whose sum is 1. No pixel: both are 1. A corner
    that is not finite: both are infinite.
    """
    counts = np.empty((1, scored.shape[0], 3 * N_BINS + 2), np.int64)
    for n in range(states.shape[0]):
        polygon_histograms_kernel(
            states[n : n + 1],
            scored,
            needed,
            parent,
            offset,
            rest_angle,
            first_column,
            angle_column,
            corners,
            corner_start,
            image,
            counts,
        )
        for j in range(scored.shape[0]):
            own = counts[0, j]
            area = own[3 * N_BINS]
            if area < 0:
                squared_distance[n, j] = np.inf
                uncovered[n, j] = np.inf
                continue
            if area == 0:
                squared_distance[n, j] = 1.0
                uncovered[n, j] = 1.0
                continue
            overlap = 0.0
            reference = sqrt_reference[scored[j]]
            for b in range(3 * N_BINS):
                if own[b] > 0:
                    overlap += np.sqrt(own[b] / (3.0 * area)) * reference[b]
            squared_distance[n, j] = 1.0 - min(overlap, 1.0)
            uncovered[n, j] = 1.0 - own[3 * N_BINS + 1] / area
