"""Robust reprojection errors of named points, as compiled code."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def keypoint_pulls(points, P, uv, noise, scale, information, gradient, cost):
    """Robust cost (K,), matrix (K, 3, 3) and gradient (K, 3) of points (K, 3) m against uv (C, K, 2) undistorted px.

    P : (C, 3, 4).  noise : (C, K) px, standard deviation; a uv of NaN has no say.  scale : error in deviations at which
    a view loses three quarters of its pull (Geman-McClure). A point behind a camera costs the limit, scale^2 / 2.
    """
    scale_2 = scale * scale
    J = np.empty((2, 3))
    e = np.empty(2)
    for k in range(points.shape[0]):
        information[k] = 0.0
        gradient[k] = 0.0
        cost[k] = 0.0
        x, y, z = points[k]
        for c in range(P.shape[0]):
            if np.isnan(uv[c, k, 0]):
                continue
            w = P[c, 2, 0] * x + P[c, 2, 1] * y + P[c, 2, 2] * z + P[c, 2, 3]
            if not w > 1e-6:
                cost[k] += 0.5 * scale_2
                continue
            inverse = 1.0 / noise[c, k]
            error_2 = 0.0
            for a in range(2):
                at = (P[c, a, 0] * x + P[c, a, 1] * y + P[c, a, 2] * z + P[c, a, 3]) / w
                for r in range(3):
                    J[a, r] = (P[c, a, r] - at * P[c, 2, r]) / w * inverse
                e[a] = (at - uv[c, k, a]) * inverse
                error_2 += e[a] * e[a]
            share = scale_2 / (scale_2 + error_2)
            cost[k] += 0.5 * scale_2 * (1.0 - share)
            weight = share * share
            for r in range(3):
                gradient[k, r] += weight * (J[0, r] * e[0] + J[1, r] * e[1])
                for s in range(3):
                    information[k, r, s] += weight * (J[0, r] * J[0, s] + J[1, r] * J[1, s])


@njit(cache=True, nogil=True)
def keypoint_costs(points, P, uv, noise, scale, out):
    """The robust cost alone, out (N, K), of points (N, K, 3) m; as `keypoint_pulls`."""
    scale_2 = scale * scale
    for n in range(points.shape[0]):
        for k in range(points.shape[1]):
            x, y, z = points[n, k]
            total = 0.0
            for c in range(P.shape[0]):
                if np.isnan(uv[c, k, 0]):
                    continue
                w = P[c, 2, 0] * x + P[c, 2, 1] * y + P[c, 2, 2] * z + P[c, 2, 3]
                if not w > 1e-6:
                    total += 0.5 * scale_2
                    continue
                u = (P[c, 0, 0] * x + P[c, 0, 1] * y + P[c, 0, 2] * z + P[c, 0, 3]) / w - uv[c, k, 0]
                v = (P[c, 1, 0] * x + P[c, 1, 1] * y + P[c, 1, 2] * z + P[c, 1, 3]) / w - uv[c, k, 1]
                error_2 = (u * u + v * v) / (noise[c, k] * noise[c, k])
                total += 0.5 * scale_2 * error_2 / (scale_2 + error_2)
            out[n, k] = total
