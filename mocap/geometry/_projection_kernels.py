"""Projection of world points by OpenCV's two camera models, point by point."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

MIN_DEPTH_M = 1e-6  # closer points are numerically at the optical centre
_AXIS = 1e-8  # normalised radius below which a fisheye's bend is 1


@njit(cache=True, nogil=True, error_model="numpy")
def project_pinhole(points, R, t, K, d, limit, uv, depth):
    """Pixels and depths of points (N, 3) m into uv (N, 2), NaN where there are none, and depth (N,).

    d : (8,) k1 k2 p1 p2 k3 k4 k5 k6.  limit : largest normalised radius.
    """
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        c = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        a = (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]) / c
        b = (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]) / c
        s = a * a + b * b
        depth[i] = c
        if c > MIN_DEPTH_M and math.sqrt(s) <= limit:
            radial = (1 + s * (d[0] + s * (d[1] + s * d[4]))) / (1 + s * (d[5] + s * (d[6] + s * d[7])))
            ab2 = 2 * a * b
            uv[i, 0] = K[0, 0] * (a * radial + d[2] * ab2 + d[3] * (s + 2 * a * a)) + K[0, 2]
            uv[i, 1] = K[1, 1] * (b * radial + d[2] * (s + 2 * b * b) + d[3] * ab2) + K[1, 2]
        else:
            uv[i, 0] = uv[i, 1] = np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def project_fisheye(points, R, t, K, d, limit, uv, depth):
    """As project_pinhole.  d : (8,) k1 k2 k3 k4, zeros.  limit : largest angle to the axis, rad."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        c = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        a = (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]) / c
        b = (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]) / c
        r = math.sqrt(a * a + b * b)
        theta = math.atan(r)
        depth[i] = c
        if c > MIN_DEPTH_M and theta <= limit:
            t2 = theta * theta
            bent = theta * (1 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3]))))
            scale = bent / r if r > _AXIS else 1.0
            uv[i, 0] = K[0, 0] * a * scale + K[0, 2]
            uv[i, 1] = K[1, 1] * b * scale + K[1, 2]
        else:
            uv[i, 0] = uv[i, 1] = np.nan
