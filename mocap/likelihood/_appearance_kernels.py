"""Which zone of a posed body a point of the hull's surface belongs to."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def nearest_cone(point, start, end, radii):
    """Nearest cone to a point: its index, how far along its axis (0 to 1), and the distance, negative inside."""
    best = np.inf
    cone = -1
    at = 0.0
    for k in range(start.shape[0]):
        ax = end[k, 0] - start[k, 0]
        ay = end[k, 1] - start[k, 1]
        az = end[k, 2] - start[k, 2]
        px = point[0] - start[k, 0]
        py = point[1] - start[k, 1]
        pz = point[2] - start[k, 2]
        s = (px * ax + py * ay + pz * az) / (ax * ax + ay * ay + az * az + 1e-12)
        s = min(max(s, 0.0), 1.0)
        dx = px - s * ax
        dy = py - s * ay
        dz = pz - s * az
        radius = radii[k, 0] + s * (radii[k, 1] - radii[k, 0])
        # Without the root: a point further away than the best so far cannot win.
        limit = best + radius
        square = dx * dx + dy * dy + dz * dz
        if limit < 0.0 or square >= limit * limit:
            continue
        best = math.sqrt(square) - radius
        cone = k
        at = s
    return cone, at, best


@njit(cache=True, nogil=True)
def zones_of_points(points, start, end, radii, first_zone, n_zones, zone, distance):
    """Zone of the nearest cone and the distance to it, for points (M, 3).  first_zone, n_zones : (K,), along a cone."""
    for i in range(points.shape[0]):
        k, s, d = nearest_cone(points[i], start, end, radii)
        zone[i] = first_zone[k] + min(int(s * n_zones[k]), n_zones[k] - 1)
        distance[i] = d


@njit(cache=True, nogil=True)
def limb_values(
    points, bins, table, other_distance, other_value, start, end, radii, first_zone, n_zones, values
):
    """Sum over the points of their colours' log-ratios when one limb moves and the rest of the body holds still.

    start, end : (N, K, 3) cones of the limb for N particles.  other_distance, other_value : (M,), distance to the
    rest of the body and log-ratio of the point as a part of it.  values : (N,) is filled.
    """
    n_cones = start.shape[1]
    for n in range(start.shape[0]):
        # A sphere around the limb: most points are nearer to the rest of the body.
        cx = 0.0
        cy = 0.0
        cz = 0.0
        for k in range(n_cones):
            cx += 0.5 * (start[n, k, 0] + end[n, k, 0]) / n_cones
            cy += 0.5 * (start[n, k, 1] + end[n, k, 1]) / n_cones
            cz += 0.5 * (start[n, k, 2] + end[n, k, 2]) / n_cones
        reach = 0.0
        for k in range(n_cones):
            thick = max(radii[k, 0], radii[k, 1])
            dx = start[n, k, 0] - cx
            dy = start[n, k, 1] - cy
            dz = start[n, k, 2] - cz
            reach = max(reach, math.sqrt(dx * dx + dy * dy + dz * dz) + thick)
            dx = end[n, k, 0] - cx
            dy = end[n, k, 1] - cy
            dz = end[n, k, 2] - cz
            reach = max(reach, math.sqrt(dx * dx + dy * dy + dz * dz) + thick)
        total = 0.0
        for i in range(points.shape[0]):
            dx = points[i, 0] - cx
            dy = points[i, 1] - cy
            dz = points[i, 2] - cz
            limit = reach + other_distance[i]
            if limit <= 0.0 or dx * dx + dy * dy + dz * dz >= limit * limit:
                total += other_value[i]
                continue
            k, s, d = nearest_cone(points[i], start[n], end[n], radii)
            if k >= 0 and d < other_distance[i]:
                total += table[first_zone[k] + min(int(s * n_zones[k]), n_zones[k] - 1), bins[i]]
            else:
                total += other_value[i]
        values[n] = total
