"""Colour histograms of convex polygons by scan lines; the honest twin is `likelihood.polygon_scores_numpy`.

A pixel is one uint16: three colour bins of three bits, a bit for the foreground, and above them how many pixels to the
right are surely like it (0 says nothing). Uniform colours come in runs along a row, so that counting runs instead of
pixels needs few histogram accesses, and none of the pixels inside a run that is marked.
"""

from __future__ import annotations

import numpy as np
from numba import njit

N_BINS = 8
_BIN_MASK = 7
_FOREGROUND_SHIFT = 9
_RUN_SHIFT = 10
_VALUE_MASK = 1023
_LONGEST_RUN = 63


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
def mark_runs_kernel(bins, out):
    """Fill out (H, W): bins (H, W), and above each how many pixels to its right are like it, at most 63."""
    n_rows, n_columns = bins.shape
    for row in range(n_rows):
        following = -1
        run = 0
        for column in range(n_columns - 1, -1, -1):
            value = bins[row, column] & _VALUE_MASK
            run = min(run + 1, _LONGEST_RUN) if value == following else 0
            out[row, column] = value | (run << _RUN_SHIFT)
            following = value


@njit(cache=True, nogil=True)
def count_polygon(x, y, image, histogram):
    """Add the pixels of a convex polygon to histogram (3 * 8,); returns its area and foreground area in pixels.

    x, y : (C,) finite corners. A pixel belongs to the polygon when its centre does, left and upper border included.
    Pixels outside the image count for the area only.
    """
    # Far outside: bounded before the cast to an integer. The area then misses rows that no histogram sees anyway.
    first = int(np.ceil(max(y.min(), -1e6)))
    last = int(np.ceil(min(y.max(), 1e6)))
    left = np.full(max(last - first, 0), np.inf)
    right = np.full(max(last - first, 0), -np.inf)
    _cut_rows(x, y, first, left, right)
    area = 0
    foreground = 0
    for k in range(left.shape[0]):
        if not right[k] > left[k]:
            continue
        start = int(np.ceil(max(left[k], -1e6)))
        stop = int(np.ceil(min(right[k], 1e6)))
        area += stop - start
        row = first + k
        if 0 <= row < image.shape[0]:
            foreground += _count_row(image[row], max(start, 0), min(stop, image.shape[1]), histogram)
    return area, foreground


@njit(cache=True, nogil=True)
def _cut_rows(x, y, first, left, right):
    """Where the border of a polygon (C,) cuts the rows from `first` on: the least and the greatest column."""
    n = x.shape[0]
    for i in range(n):
        # From the upper end whatever the edge's sense, so that neighbours round alike.
        a, b = (i - 1, i) if y[i - 1] < y[i] else (i, i - 1)
        top = int(np.ceil(max(y[a], -1e6)))
        bottom = int(np.ceil(min(y[b], 1e6)))
        for row in range(top, bottom):
            cut = x[a] + (row - y[a]) / (y[b] - y[a]) * (x[b] - x[a])
            left[row - first] = min(left[row - first], cut)
            right[row - first] = max(right[row - first], cut)


@njit(cache=True, nogil=True)
def _count_row(line, start, stop, histogram):
    """Add the pixels of one row from start to stop to histogram, run by run; returns how many are foreground."""
    foreground = 0
    while start < stop:
        value = line[start] & _VALUE_MASK
        end = start + 1 + (line[start] >> _RUN_SHIFT)
        while end < stop and line[end] & _VALUE_MASK == value:
            end += 1 + (line[end] >> _RUN_SHIFT)
        run = min(end, stop) - start
        histogram[value & _BIN_MASK] += run
        histogram[N_BINS + ((value >> 3) & _BIN_MASK)] += run
        histogram[2 * N_BINS + ((value >> 6) & _BIN_MASK)] += run
        foreground += run * (value >> _FOREGROUND_SHIFT)
        start = end
    return foreground


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
