"""Residuals on a posed body, gathered per joint and spread over the state once.

A scalar residual r on a point x that is rigid with joint j has the derivative n . dx/dstate. Every movement of the
joint is a twist, so that derivative is a row of six numbers (n, x cross n) times the twists; the sums of their
squares over all points are one 6 x 6 matrix per joint, whatever the number of points and rotations.
Source: the composite-body recursion of rigid-body dynamics, R. Featherstone, Rigid Body Dynamics Algorithms, 6.2.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mocap.body._kernels import chain_axes


@njit(cache=True, nogil=True)
def place_points(points, joint, R, t, placed):
    """World places (M, 3) of points (M, 3) given in the frames of their joints (M,)."""
    for i in range(points.shape[0]):
        j = joint[i]
        for r in range(3):
            placed[i, r] = (
                R[j, r, 0] * points[i, 0] + R[j, r, 1] * points[i, 1] + R[j, r, 2] * points[i, 2] + t[j, r]
            )


@njit(cache=True, nogil=True)
def posed(state, chain, cones, flesh_points, flesh_joint):
    """What a state (D,) does to a body: places of the joints (J, 3), axes of the rotations (n_dofs, 3), ends of the
    cones (K, 3) twice, and the flesh points (M, 3), all in the world.  chain, cones : as kernels take the body.
    """
    parent, offset, dof_joint, dof_axis, dof_column = chain
    cone_start, cone_end, _, cone_joint, _ = cones
    R = np.empty((parent.shape[0], 3, 3))
    t = np.empty((parent.shape[0], 3))
    axes = np.empty((dof_joint.shape[0], 3))
    chain_axes(state, parent, offset, dof_joint, dof_axis, dof_column, R, t, axes)
    start = np.empty_like(cone_start)
    end = np.empty_like(cone_end)
    place_points(cone_start, cone_joint, R, t, start)
    place_points(cone_end, cone_joint, R, t, end)
    flesh = np.empty_like(flesh_points)
    place_points(flesh_points, flesh_joint, R, t, flesh)
    return t, axes, start, end, flesh


@njit(cache=True, nogil=True)
def robust_loss(residual, scale, gain):
    """Geman-McClure cost of a residual, and its weight in the normal equations."""
    q = residual / scale
    s = 1.0 + q * q
    return gain * 0.5 * scale * scale * q * q / s, gain / (s * s)


@njit(cache=True, nogil=True)
def add_pull(x, y, z, nx, ny, nz, residual, weight, j, pulls):
    """Add one scalar residual with derivative n . dx/dstate at the point (x, y, z) of joint j.

    pulls : (J, 7, 6); rows 0 to 5 hold the upper triangle of the sum of w w^T, row 6 that of residual w, with
    w = (n, x cross n).
    """
    mx = y * nz - z * ny
    my = z * nx - x * nz
    mz = x * ny - y * nx
    P = pulls[j]
    wx = weight * nx
    wy = weight * ny
    wz = weight * nz
    P[0, 0] += wx * nx
    P[0, 1] += wx * ny
    P[0, 2] += wx * nz
    P[0, 3] += wx * mx
    P[0, 4] += wx * my
    P[0, 5] += wx * mz
    P[1, 1] += wy * ny
    P[1, 2] += wy * nz
    P[1, 3] += wy * mx
    P[1, 4] += wy * my
    P[1, 5] += wy * mz
    P[2, 2] += wz * nz
    P[2, 3] += wz * mx
    P[2, 4] += wz * my
    P[2, 5] += wz * mz
    wx = weight * mx
    wy = weight * my
    P[3, 3] += wx * mx
    P[3, 4] += wx * my
    P[3, 5] += wx * mz
    P[4, 4] += wy * my
    P[4, 5] += wy * mz
    P[5, 5] += weight * mz * mz
    wr = weight * residual
    P[6, 0] += wr * nx
    P[6, 1] += wr * ny
    P[6, 2] += wr * nz
    P[6, 3] += wr * mx
    P[6, 4] += wr * my
    P[6, 5] += wr * mz


@njit(cache=True, nogil=True)
def spread_pulls(pulls, parent, t, axes, dof_joint, dof_column, moves, H, g):
    """Add the gathered residuals to H (D, D) and g (D,); columns 0 to 2 move the whole body.

    moves : (J, n_dofs) bool, the rotations that move each joint.  pulls is used up: it holds the sums over
    each joint and all below afterwards.
    """
    J = pulls.shape[0]
    for j in range(J):
        for a in range(6):
            for b in range(a):
                pulls[j, a, b] = pulls[j, b, a]
    whole = np.zeros((7, 6))
    for j in range(J - 1, -1, -1):
        p = parent[j]
        for a in range(7):
            for b in range(6):
                if p < 0:
                    whole[a, b] += pulls[j, a, b]
                else:
                    pulls[p, a, b] += pulls[j, a, b]
    for a in range(3):
        g[a] += whole[6, a]
        for b in range(3):
            H[a, b] += whole[a, b]
    n_dofs = dof_joint.shape[0]
    twist = np.empty((n_dofs, 6))
    for d in range(n_dofs):
        q = t[dof_joint[d]]
        u = axes[d]
        twist[d, 0] = q[1] * u[2] - q[2] * u[1]
        twist[d, 1] = q[2] * u[0] - q[0] * u[2]
        twist[d, 2] = q[0] * u[1] - q[1] * u[0]
        twist[d, 3] = u[0]
        twist[d, 4] = u[1]
        twist[d, 5] = u[2]
    force = np.empty(6)
    for d in range(n_dofs):
        j = dof_joint[d]
        column = dof_column[d]
        for a in range(6):
            force[a] = 0.0
            for b in range(6):
                force[a] += pulls[j, a, b] * twist[d, b]
        for b in range(6):
            g[column] += pulls[j, 6, b] * twist[d, b]
        for c in range(3):
            H[column, c] += force[c]
            H[c, column] += force[c]
        # What moves this rotation's joint: itself and all up the chain.
        for e in range(n_dofs):
            if not moves[j, e]:
                continue
            value = 0.0
            for b in range(6):
                value += twist[e, b] * force[b]
            H[column, dof_column[e]] += value
            if dof_joint[e] != j:
                H[dof_column[e], column] += value
