"""Pinhole and fisheye projection of world points, and back.

World frame: metres, z up. Camera frame: x right, y down, z forward (OpenCV). Pixels are (column, row) with the
centre of the first pixel at (0, 0), as OpenCV counts them. Distortion formulas are OpenCV's; what is added here
is the limit of validity: a radial polynomial folds back beyond some radius, and a point out there must not
appear inside the picture.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from mocap.arrays import Array
from mocap.geometry import _projection_kernels

_MAX_TAN = 50.0  # search limit for the fold: tan(88.9 deg)


def max_normalised_radius(dist: Array, is_fisheye: bool) -> float:
    """Largest undistorted normalised radius up to which the radial distortion is monotonic.

    dist : (n,) OpenCV coefficients (k1, k2, p1, p2[, k3[, k4, k5, k6]]) or fisheye (k1, k2, k3, k4).
    Returns tan(angle) for pinhole models and the angle itself (rad) for fisheye; `inf` when it never folds.
    Source: CF Eq. 2.7-2.8 with the radial term of reading guide 1 (k2 r^4).
    """
    coefficients = np.zeros(8)
    coefficients[: min(len(dist), 8)] = np.asarray(dist, dtype=np.float64)[:8]
    return _fold(tuple(coefficients.tolist()), is_fisheye)


@lru_cache(maxsize=256)
def _fold(d: tuple[float, ...], is_fisheye: bool) -> float:
    """`max_normalised_radius` of eight coefficients; looking for it takes longer than projecting a hundred points."""
    if is_fisheye:
        theta = np.linspace(0.0, np.pi, 2001)
        t2 = theta**2
        slope = 1 + t2 * (3 * d[0] + t2 * (5 * d[1] + t2 * (7 * d[2] + t2 * 9 * d[3])))
        bad = np.flatnonzero(slope <= 0)
        return float(theta[bad[0]]) if bad.size else float("inf")
    k1, k2, k3, k4, k5, k6 = d[0], d[1], d[4], d[5], d[6], d[7]
    r = np.concatenate([np.linspace(0.0, 3.0, 6001), np.geomspace(3.0, _MAX_TAN, 500)[1:]])
    r2 = r * r
    scaled = r * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    bad = np.flatnonzero(np.diff(scaled) <= 0)
    return float(r[bad[0]]) if bad.size else float("inf")


def project_points(
    points_world: Array,
    K: Array,
    dist: Array,
    R: Array,
    t: Array,
    *,
    is_fisheye: bool = False,
) -> tuple[Array, Array]:
    """Pixels and depths of world points.

    points_world : (..., 3) m, world.  K : (3, 3) px.  dist : (n,).  R : (3, 3), t : (3,) m, world to camera.
    Returns uv (..., 2) px and depth (...,) m. Points behind the camera, beyond the fold of the distortion, or
    NaN give uv = NaN (their depth is still given).
    Source: CF Eq. 2.1-2.8.
    """
    points = np.asarray(points_world, dtype=np.float64)
    flat = np.ascontiguousarray(points.reshape(-1, 3))
    uv, depth = np.empty((len(flat), 2)), np.empty(len(flat))
    d = np.zeros(max(8, len(dist)))
    d[: len(dist)] = dist
    n_compiled = 4 if is_fisheye else 8
    # A model with thin prisms or a tilted sensor is OpenCV's alone: here is only where it looks.
    is_compiled = is_fisheye or not d[n_compiled:].any()
    project = _projection_kernels.project_fisheye if is_fisheye else _projection_kernels.project_pinhole
    matrices = (np.ascontiguousarray(own, dtype=np.float64) for own in (R, t, K))
    project(flat, *matrices, d[:8], max_normalised_radius(dist, is_fisheye), uv, depth)
    if not is_compiled and len(seen := np.flatnonzero(~np.isnan(uv[:, 0]))):
        rotation, _ = cv2.Rodrigues(np.asarray(R, dtype=np.float64))
        uv[seen] = cv2.projectPoints(flat[seen], rotation, np.asarray(t, dtype=np.float64), K, d)[0][:, 0]
    return uv.reshape(*points.shape[:-1], 2), depth.reshape(points.shape[:-1])


def rays_from_pixels(uv: Array, K: Array, dist: Array, R: Array, *, is_fisheye: bool = False) -> Array:
    """Unit viewing directions in the world frame through pixels.

    uv : (..., 2) px. Returns (..., 3), unit length, pointing away from the camera; NaN pixels give NaN.
    """
    pixels = np.asarray(uv, dtype=np.float64)
    flat = pixels.reshape(-1, 1, 2)
    if flat.shape[0] == 0:
        return np.zeros((*pixels.shape[:-1], 3))
    if is_fisheye:
        coefficients = np.zeros(4)
        coefficients[: min(4, len(dist))] = dist[:4]
        normalised = cv2.fisheye.undistortPoints(flat, K, coefficients)
    else:
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-12)
        normalised = cv2.undistortPoints(
            flat, K, np.asarray(dist, dtype=np.float64), None, None, None, criteria
        )
    cam = np.column_stack([normalised.reshape(-1, 2), np.ones(len(flat))])
    cam /= np.linalg.norm(cam, axis=1, keepdims=True)
    return (cam @ R).reshape(*pixels.shape[:-1], 3)
