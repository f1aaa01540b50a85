"""Epipolar geometry between two calibrated views (undistorted pixel coordinates)."""

from __future__ import annotations

import numpy as np

from mocap.arrays import Array


def fundamental_matrix(K_a: Array, R_a: Array, t_a: Array, K_b: Array, R_b: Array, t_b: Array) -> Array:
    """Fundamental matrix F with x_b^T F x_a = 0 for undistorted pixels of the same world point.

    K_* : (3, 3) px, R_* : (3, 3), t_* : (3,) m, world to camera. Returns (3, 3), unit Frobenius norm.
    Raises ValueError when both optical centres coincide (no epipolar geometry).
    """
    R = R_b @ R_a.T
    t = t_b - R @ t_a
    norm = float(np.linalg.norm(t))
    if norm < 1e-12:
        raise ValueError("fundamental_matrix: the two cameras share one optical centre")
    tx = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
    F = np.linalg.inv(K_b).T @ tx @ R @ np.linalg.inv(K_a)
    return F / np.linalg.norm(F)


def epipolar_lines(F: Array, uv_a: Array) -> Array:
    """Lines a u + b v + c = 0 in view b of undistorted pixels of view a; a^2 + b^2 = 1.

    F : (3, 3).  uv_a : (N, 2) px. Returns (N, 3).
    """
    homogeneous = np.column_stack([uv_a, np.ones(len(uv_a))])
    lines = homogeneous @ F.T
    return lines / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)


def symmetric_epipolar_distance(F: Array, uv_a: Array, uv_b: Array) -> Array:
    """Symmetric epipolar distance of point pairs: root of the two squared point-to-line distances, px.

    uv_a, uv_b : (N, 2) undistorted px. Returns (N,).
    Source: CF Eq. 6.6.
    """
    in_b = np.sum(epipolar_lines(F, uv_a) * np.column_stack([uv_b, np.ones(len(uv_b))]), axis=1)
    in_a = np.sum(epipolar_lines(F.T, uv_b) * np.column_stack([uv_a, np.ones(len(uv_a))]), axis=1)
    return np.hypot(in_a, in_b)
