"""Kernel of visibility: which zone of a posed body a camera sees in a pixel."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def meet_cone(o, u, start, end, radii, squared):
    """Where a ray from o along u comes nearest to a cone's axis: the place along the axis (0 to 1), the depth along the
    ray, the squared distance, and the cone's radius there.  squared : of the axis' length."""
    ax = end[0] - start[0]
    ay = end[1] - start[1]
    az = end[2] - start[2]
    wx = start[0] - o[0]
    wy = start[1] - o[1]
    wz = start[2] - o[2]
    au = ax * u[0] + ay * u[1] + az * u[2]
    aw = ax * wx + ay * wy + az * wz
    uw = u[0] * wx + u[1] * wy + u[2] * wz
    det = squared - au * au
    s = (au * uw - aw) / det if det > 1e-9 * squared else 0.5
    s = min(max(s, 0.0), 1.0)
    fx = wx + s * ax
    fy = wy + s * ay
    fz = wz + s * az
    nearest = fx * u[0] + fy * u[1] + fz * u[2]
    square = fx * fx + fy * fy + fz * fz - nearest * nearest
    return s, nearest, max(square, 0.0), radii[0] + s * (radii[1] - radii[0])


@njit(cache=True, nogil=True)
def see_cones(origins, first, directions, start, end, radii, depth, miss, cone, at):
    """What every ray meets before its `depth`, or failing that passes more closely than its `miss`.

    origins : (C, 3).  first : (C + 1,), where each camera's rays begin.  directions : (M, 3) unit.  start, end : (K,
    3).  depth, miss : (M,), inf and the largest distance for rays that have met nothing; become the depth at which the
    ray enters a cone (inf when it passes by) and by how much it misses it (0 when it enters).  cone, at : (M,), the
    cone and the place along its axis, 0 to 1; left alone where there is none.
    """
    for k in range(start.shape[0]):
        square_length = 1e-12
        for c in range(3):
            square_length += (end[k, c] - start[k, c]) ** 2
        reach = 0.5 * math.sqrt(square_length) + max(radii[k, 0], radii[k, 1])
        for c in range(origins.shape[0]):
            o = origins[c]
            mx = 0.5 * (start[k, 0] + end[k, 0]) - o[0]
            my = 0.5 * (start[k, 1] + end[k, 1]) - o[1]
            mz = 0.5 * (start[k, 2] + end[k, 2]) - o[2]
            square_m = mx * mx + my * my + mz * mz
            for i in range(first[c], first[c + 1]):
                # A sphere around the cone: most rays pass it by.
                along = mx * directions[i, 0] + my * directions[i, 1] + mz * directions[i, 2]
                limit = reach + miss[i]
                if square_m - along * along > limit * limit or along < 0.0 or along - reach >= depth[i]:
                    continue
                s, nearest, square, radius = meet_cone(
                    o, directions[i], start[k], end[k], radii[k], square_length
                )
                if square < radius * radius:
                    entry = nearest - math.sqrt(radius * radius - square)
                    if entry < depth[i]:
                        depth[i] = entry
                        miss[i] = 0.0
                        cone[i] = k
                        at[i] = s
                elif miss[i] > 0.0:
                    gap = math.sqrt(square) - radius
                    if gap < miss[i]:
                        miss[i] = gap
                        cone[i] = k
                        at[i] = s


@njit(cache=True, nogil=True)
def limb_values(
    origins,
    first,
    directions,
    bins,
    table,
    other_depth,
    other_miss,
    other_value,
    start,
    end,
    radii,
    first_zone,
    n_zones,
    values,
):
    """Sum over the rays of their colours' log-ratios when one limb moves and the rest of the body holds still.

    start, end : (N, K, 3) cones of the limb for N particles.  other_depth, other_miss, other_value : (M,), what the
    rest of the body gives.  values : (N,) is filled.
    """
    n_rays = directions.shape[0]
    cone = np.empty(n_rays, np.int64)
    at = np.empty(n_rays)
    depth = np.empty(n_rays)
    miss = np.empty(n_rays)
    base = 0.0
    for i in range(n_rays):
        base += other_value[i]
    for n in range(start.shape[0]):
        for i in range(n_rays):
            cone[i] = -1
            depth[i] = other_depth[i]
            miss[i] = other_miss[i]
        see_cones(origins, first, directions, start[n], end[n], radii, depth, miss, cone, at)
        total = base
        for i in range(n_rays):
            k = cone[i]
            if k >= 0:
                zone = first_zone[k] + min(int(at[i] * n_zones[k]), n_zones[k] - 1)
                total += table[zone, bins[i]] - other_value[i]
        values[n] = total
