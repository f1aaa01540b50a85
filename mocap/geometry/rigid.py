"""Rotations about axes, rigid transforms and twists.

Rotations and rotation vectors come from scipy.spatial.transform; only the exponential map of a twist is here,
because the kinematic chains of the body are written with it.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from mocap.arrays import Array


def matrix_from_rotation_vector(rotation_vector: Array) -> Array:
    """Rotation matrices of rotation vectors (Rodrigues).  rotation_vector : (..., 3) rad. Returns (..., 3, 3)."""
    v = np.asarray(rotation_vector, dtype=np.float64)
    return Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix().reshape(*v.shape[:-1], 3, 3)


def rotation_vector_from_matrix(R: Array) -> Array:
    """Rotation vectors of rotation matrices.  R : (..., 3, 3). Returns (..., 3) rad, angle in [0, pi]."""
    m = np.asarray(R, dtype=np.float64)
    return Rotation.from_matrix(m.reshape(-1, 3, 3)).as_rotvec().reshape(*m.shape[:-2], 3)


def matrix_from_twist(axis: Array, point: Array, angle: float) -> Array:
    """4 x 4 transform of a rotation by `angle` about the line through `point` along `axis`.

    axis : (3,) unit, point : (3,) m, angle rad, all in one frame. Returns (4, 4).
    Source: CF Eq. A.5-A.9.
    """
    R = Rotation.from_rotvec(np.asarray(axis, dtype=np.float64) * angle).as_matrix()
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = np.asarray(point) - R @ np.asarray(point)
    return T


def wrap_angle(angle: Array | float) -> Array:
    """Angles wrapped to (-pi, pi].  angle : (...,) rad."""
    a = np.asarray(angle, dtype=np.float64)
    return np.pi - np.mod(np.pi - a, 2 * np.pi)
