"""The mean of many poses of one body, taken where it has a meaning: over rotations, not over their angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.model import Body

_N_STEPS = 12
_SMALL_STEP = 1e-10


def mean_rotation(R: Array, weights: Array) -> Array:
    """The rotation nearest to the weighted mean of rotation matrices (N, 3, 3), weights (N,).  Returns (3, 3).

    Raises ValueError when no rotation is nearest: the weights vanish, or the rotations cancel out.
    Source: Moakher 2002, the projected arithmetic mean.
    """
    M = np.einsum("n,nrc->rc", weights, R)
    U, s, Vt = np.linalg.svd(M)
    sign = float(np.sign(np.linalg.det(U @ Vt)))
    if not s[1] + sign * s[2] > 1e-12 * max(float(np.abs(weights).sum()), 1e-300):
        raise ValueError("these rotations have no mean: they cancel out, or have no weight")
    return np.asarray(U @ np.diag([1.0, 1.0, sign]) @ Vt)


def mean_state(body: Body, states: Array, weights: Array, start: Array) -> Array:
    """The weighted mean of states (N, D), every joint's rotation averaged as a rotation, inside the limits: (D,).

    weights : (N,), sum 1.  start : (D,), the mean of the angles, from which the angles of joints with two or three
    rotations are found; columns of other joints are taken from it.
    Angles that lie far apart may be nearly the same rotation, and their arithmetic mean another one.
    Source: CF Eq. 3.19; departs from it because an arithmetic mean of Euler angles depends on the choice of axes.
    """
    out = start.copy()
    for j in np.unique(body.dof_joint):
        rows = np.flatnonzero(body.dof_joint == j)
        if len(rows) < 2:
            continue
        columns, axes = body.dof_column[rows], body.dof_axis[rows]
        R, _ = _rotations(states[:, columns], axes)
        try:
            mean = mean_rotation(R, weights)
        except ValueError:
            continue
        out[columns] = _angles(
            mean, axes, start[columns], body.layout.lower[columns], body.layout.upper[columns]
        )
    return out


def _rotations(angles: Array, axes: NDArray[np.int64]) -> tuple[Array, Array]:
    """Products of principal rotations, (N, n) rad -> (N, 3, 3), and their derivatives by the angles, (N, n, 3, 3)."""
    N, n = angles.shape
    single = np.zeros((N, n, 3, 3))
    slope = np.zeros((N, n, 3, 3))
    for k in range(n):
        a, b = (int(axes[k]) + 1) % 3, (int(axes[k]) + 2) % 3
        c, s = np.cos(angles[:, k]), np.sin(angles[:, k])
        single[:, k, axes[k], axes[k]] = 1.0
        single[:, k, a, a] = single[:, k, b, b] = c
        single[:, k, b, a], single[:, k, a, b] = s, -s
        slope[:, k, a, a] = slope[:, k, b, b] = -s
        slope[:, k, b, a], slope[:, k, a, b] = c, -c
    derivative = np.empty((N, n, 3, 3))
    for k in range(n):
        product = np.tile(np.eye(3), (N, 1, 1))
        for m in range(n):
            product = product @ (slope if m == k else single)[:, m]
        derivative[:, k] = product
    product = np.tile(np.eye(3), (N, 1, 1))
    for m in range(n):
        product = product @ single[:, m]
    return product, derivative


def _angles(R: Array, axes: NDArray[np.int64], start: Array, lower: Array, upper: Array) -> Array:
    """Angles (n,) inside the limits whose rotation is nearest to R (3, 3), from a start (n,): damped Gauss-Newton."""
    x = np.clip(start, lower, upper)
    found, J = _rotations(x[None], axes)
    cost = float(((found[0] - R) ** 2).sum())
    damping = 1e-6
    for _ in range(_N_STEPS):
        A = J[0].reshape(len(x), 9)
        g = A @ (found[0] - R).ravel()
        free = ~(((x <= lower) & (g > 0)) | ((x >= upper) & (g < 0)))
        if not free.any():
            break
        step = np.zeros_like(x)
        H = A[free] @ A[free].T
        step[free] = -np.linalg.solve(H + damping * np.eye(len(H)), g[free])
        candidate = np.clip(x + step, lower, upper)
        new, new_J = _rotations(candidate[None], axes)
        new_cost = float(((new[0] - R) ** 2).sum())
        if new_cost < cost:
            moved = float(np.abs(candidate - x).max())
            x, found, J, cost = candidate, new, new_J, new_cost
            damping = max(0.1 * damping, 1e-9)
            if moved < _SMALL_STEP:
                break
        else:
            damping *= 30.0
    return x
