"""Residuals on a posed body, gathered per joint and spread over the state once.

A scalar residual r on a point x that is rigid with joint j has the derivative n . dx/dstate. Every movement of the
joint is a twist, so that derivative is a row of six numbers (n, x cross n) times the twists; the sums of their
squares over all points are one 6 x 6 matrix per joint, whatever the number of points and rotations.
Source: the composite-body recursion of rigid-body dynamics, R. Featherstone, Rigid Body Dynamics Algorithms, 6.2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mocap.body._kernels import chain_axes


class FleshPoints(NamedTuple):
    """Points of the flesh.  points : (M, 3) m, each in the frame of its joint (M,)."""

    points: NDArray[np.float64]
    joint: NDArray[np.int64]


class Placed(NamedTuple):
    """A body in one pose, world.  t : (J, 3) m, places of the joints.  axes : (n_dofs, 3) of the rotations.  start, end
    : (K, 3) m, of the cones.  flesh : (M, 3) m."""

    t: NDArray[np.float64]
    axes: NDArray[np.float64]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    flesh: NDArray[np.float64]


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
def place_body(state, body, flesh):
    """What a state (D,) does to a body with some of its flesh."""
    chain, cones = body.chain, body.cones
    J = chain.parent.shape[0]
    R = np.empty((J, 3, 3))
    t = np.empty((J, 3))
    axes = np.empty((chain.dof_joint.shape[0], 3))
    chain_axes(state, chain, R, t, axes)
    start = np.empty_like(cones.start)
    end = np.empty_like(cones.end)
    place_points(cones.start, cones.joint, R, t, start)
    place_points(cones.end, cones.joint, R, t, end)
    points = np.empty_like(flesh.points)
    place_points(flesh.points, flesh.joint, R, t, points)
    return Placed(t, axes, start, end, points)


@njit(cache=True, nogil=True)
def from_axis(at, start, end, k):
    """Where a point lies beside the axis of cone k: place along it in [0, 1], and the way from there, three numbers.

    at : three numbers.  start, end : (K, 3).
    """
    ax = end[k, 0] - start[k, 0]
    ay = end[k, 1] - start[k, 1]
    az = end[k, 2] - start[k, 2]
    px = at[0] - start[k, 0]
    py = at[1] - start[k, 1]
    pz = at[2] - start[k, 2]
    s = (px * ax + py * ay + pz * az) / (ax * ax + ay * ay + az * az + 1e-12)
    s = min(max(s, 0.0), 1.0)
    return s, px - s * ax, py - s * ay, pz - s * az


@njit(cache=True, nogil=True)
def taper_of(start, end, k, widening, s):
    """How the radius of cone k changes with the place, three numbers; widening : from its first radius to its last.

    Beside the cone, at a place s in (0, 1), it changes along the axis; beyond its ends it does not.
    """
    if s <= 0.0 or s >= 1.0:
        return 0.0, 0.0, 0.0
    ax = end[k, 0] - start[k, 0]
    ay = end[k, 1] - start[k, 1]
    az = end[k, 2] - start[k, 2]
    t = widening / (ax * ax + ay * ay + az * az + 1e-12)
    return t * ax, t * ay, t * az


@njit(cache=True, nogil=True)
def robust_loss(residual, scale, gain):
    """Geman-McClure cost of a residual, and its weight in the normal equations."""
    q = residual / scale
    s = 1.0 + q * q
    return gain * 0.5 * scale * scale * q * q / s, gain / (s * s)


@njit(cache=True, nogil=True)
def add_pull(at, n, residual, weight, j, pulls):
    """Add one scalar residual with derivative n . dx/dstate at a point of joint j.  at, n : three numbers each.

    pulls : (J, 7, 6); rows 0 to 5 hold the upper triangle of the sum of w w^T, row 6 that of residual w, with
    w = (n, x cross n).
    """
    x, y, z = at
    nx, ny, nz = n
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
def _sum_over_branches(pulls, parent):
    """Make of the sums of each joint those of it and all below; returns the sums of the whole body, (7, 6)."""
    J = pulls.shape[0]
    for j in range(J):
        for a in range(6):
            for b in range(a):
                pulls[j, a, b] = pulls[j, b, a]
    whole = np.zeros((7, 6))
    for j in range(J - 1, -1, -1):
        target = whole if parent[j] < 0 else pulls[parent[j]]
        for a in range(7):
            for b in range(6):
                target[a, b] += pulls[j, a, b]
    return whole


@njit(cache=True, nogil=True)
def _twists(t, axes, dof_joint):
    """The twist of each rotation, (n_dofs, 6): its moment about the world's origin, and its axis."""
    twist = np.empty((dof_joint.shape[0], 6))
    for d in range(dof_joint.shape[0]):
        q = t[dof_joint[d]]
        u = axes[d]
        twist[d, 0] = q[1] * u[2] - q[2] * u[1]
        twist[d, 1] = q[2] * u[0] - q[0] * u[2]
        twist[d, 2] = q[0] * u[1] - q[1] * u[0]
        twist[d, 3] = u[0]
        twist[d, 4] = u[1]
        twist[d, 5] = u[2]
    return twist


@njit(cache=True, nogil=True)
def spread_pulls(pulls, body, t, axes, H, g):
    """Add the gathered residuals to H (D, D) and g (D,); columns 0 to 2 move the whole body.

    body : BodyArrays.  pulls is used up: it holds the sums over each joint and all below afterwards.
    """
    dof_joint, dof_column, moves = body.chain.dof_joint, body.chain.dof_column, body.moves
    whole = _sum_over_branches(pulls, body.chain.parent)
    for a in range(3):
        g[a] += whole[6, a]
        for b in range(3):
            H[a, b] += whole[a, b]
    n_dofs = dof_joint.shape[0]
    twist = _twists(t, axes, dof_joint)
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
