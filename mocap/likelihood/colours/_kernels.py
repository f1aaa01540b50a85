"""Kernels of visibility: which zone of a posed body a camera sees in a pixel.

In single precision, cone by cone over all rays and without branches, so that one instruction works on sixteen rays.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_PARALLEL = np.float32(1e-6)  # of the axis' squared length: what single precision can tell of an angle


@njit(cache=True, nogil=True, error_model="numpy")
def see_cones(columns, start, end, radii, depth, miss, cone, at):
    """What every ray meets before its `depth`, or failing that passes more closely than its `miss`.

    columns : (6, M) float32, origins and unit directions.  start, end : (K, 3).  depth, miss : (M,) float32, inf and
    the largest distance for rays that have met nothing; become the depth at which the ray enters a cone (inf when it
    passes by) and by how much it misses it (0 when it enters).  cone : (M,) int32, at : (M,) float32, the cone and the
    place along its axis, 0 to 1; left alone where there is none.
    """
    x, y, z = columns[0], columns[1], columns[2]
    ux, uy, uz = columns[3], columns[4], columns[5]
    n = x.shape[0]
    for k in range(start.shape[0]):
        at_x, at_y, at_z = np.float32(start[k, 0]), np.float32(start[k, 1]), np.float32(start[k, 2])
        ax = np.float32(end[k, 0] - start[k, 0])
        ay = np.float32(end[k, 1] - start[k, 1])
        az = np.float32(end[k, 2] - start[k, 2])
        squared = ax * ax + ay * ay + az * az + np.float32(1e-12)
        first = np.float32(radii[k, 0])
        taper = np.float32(radii[k, 1] - radii[k, 0])
        own = np.int32(k)
        for i in range(n):
            wx = at_x - x[i]
            wy = at_y - y[i]
            wz = at_z - z[i]
            au = ax * ux[i] + ay * uy[i] + az * uz[i]
            aw = ax * wx + ay * wy + az * wz
            uw = ux[i] * wx + uy[i] * wy + uz[i] * wz
            det = squared - au * au
            s = (au * uw - aw) / det
            s = s if det > _PARALLEL * squared else _HALF
            s = s if s > _ZERO else _ZERO
            s = s if s < _ONE else _ONE
            fx = wx + s * ax
            fy = wy + s * ay
            fz = wz + s * az
            nearest = fx * ux[i] + fy * uy[i] + fz * uz[i]
            dx = nearest * ux[i] - fx
            dy = nearest * uy[i] - fy
            dz = nearest * uz[i] - fz
            square = dx * dx + dy * dy + dz * dz
            radius = first + s * taper
            inner = radius * radius - square
            entry = nearest - np.sqrt(inner if inner > _ZERO else _ZERO)
            gap = np.sqrt(square) - radius
            is_ahead = nearest > _ZERO
            enters = is_ahead & (inner > _ZERO) & (entry < depth[i])
            passes = is_ahead & (inner <= _ZERO) & (gap < miss[i])
            depth[i] = entry if enters else depth[i]
            missed = gap if passes else miss[i]
            miss[i] = _ZERO if enters else missed
            cone[i] = own if enters | passes else cone[i]
            at[i] = s if enters | passes else at[i]


@njit(cache=True, nogil=True)
def limb_values(
    columns, bins, table, other_depth, other_miss, other_value, start, end, radii, first_zone, n_zones, values
):
    """Sum over the rays of their colours' log-ratios when one limb moves and the rest of the body holds still.

    start, end : (N, K, 3) cones of the limb for N particles.  other_depth, other_miss, other_value : (M,), what the
    rest of the body gives.  values : (N,) is filled.
    """
    n_rays = bins.shape[0]
    cone = np.empty(n_rays, np.int32)
    at = np.empty(n_rays, np.float32)
    depth = np.empty(n_rays, np.float32)
    miss = np.empty(n_rays, np.float32)
    base = 0.0
    for i in range(n_rays):
        base += other_value[i]
    for n in range(start.shape[0]):
        for i in range(n_rays):
            cone[i], depth[i], miss[i] = -1, other_depth[i], other_miss[i]
        see_cones(columns, start[n], end[n], radii, depth, miss, cone, at)
        total = base
        for i in range(n_rays):
            k = cone[i]
            if k >= 0:
                zone = first_zone[k] + min(int(at[i] * n_zones[k]), n_zones[k] - 1)
                total += table[zone, bins[i]] - other_value[i]
        values[n] = total
