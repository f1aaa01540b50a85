"""Forward kinematics as compiled code; the honest twin is `kinematics.transforms_by_exponentials`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray


class Chain(NamedTuple):
    """The tree of joints.  parent : (J,), -1 for the root.  offset : (J, 3) m in the parent's frame.  dof_joint,
    dof_axis, dof_column : one row per rotation in the order of application along the chain; axis 0, 1, 2 = x, y, z."""

    parent: NDArray[np.int64]
    offset: NDArray[np.float64]
    dof_joint: NDArray[np.int64]
    dof_axis: NDArray[np.int64]
    dof_column: NDArray[np.int64]


class ConeArrays(NamedTuple):
    """Flesh in joint frames.  start, end : (K, 3) m.  radii : (K, 2) m.  joint, part : (K,)."""

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    radii: NDArray[np.float64]
    joint: NDArray[np.int64]
    part: NDArray[np.int64]


class BodyArrays(NamedTuple):
    """A body as kernels take it.  moves : (J, n_dofs) bool, which rotations move which joint frame."""

    chain: Chain
    moves: NDArray[np.bool_]
    cones: ConeArrays


@njit(cache=True, nogil=True)
def forward_kinematics(state, parent, offset, dof_joint, dof_axis, dof_column, R, t):
    """Fill R (J, 3, 3) and t (J, 3), joint frame to world, of one state (D,); columns 0..2 are the root.

    The chain comes array by array: filters call this in their innermost loop.
    """
    n_joints = parent.shape[0]
    d = 0
    for j in range(n_joints):
        p = parent[j]
        if p < 0:
            for r in range(3):
                t[j, r] = state[r]
                for c in range(3):
                    R[j, r, c] = 1.0 if r == c else 0.0
        else:
            for r in range(3):
                t[j, r] = (
                    t[p, r]
                    + R[p, r, 0] * offset[j, 0]
                    + R[p, r, 1] * offset[j, 1]
                    + R[p, r, 2] * offset[j, 2]
                )
                for c in range(3):
                    R[j, r, c] = R[p, r, c]
        while d < dof_joint.shape[0] and dof_joint[d] == j:
            angle = state[dof_column[d]]
            co = math.cos(angle)
            si = math.sin(angle)
            # Right-multiply by a principal rotation: it mixes the two other columns.
            a = (dof_axis[d] + 1) % 3
            b = (dof_axis[d] + 2) % 3
            for r in range(3):
                va = R[j, r, a]
                vb = R[j, r, b]
                R[j, r, a] = co * va + si * vb
                R[j, r, b] = -si * va + co * vb
            d += 1


@njit(cache=True, nogil=True)
def transforms_kernel(states, chain, R, t):
    """Joint transforms of many states (N, D) into R (N, J, 3, 3), t (N, J, 3)."""
    parent, offset, dof_joint, dof_axis, dof_column = chain
    for n in range(states.shape[0]):
        forward_kinematics(states[n], parent, offset, dof_joint, dof_axis, dof_column, R[n], t[n])


@njit(cache=True, nogil=True)
def place_cones(states, chain, cones, start, end):
    """Ends of cones in the world, start and end (N, K, 3), of states (N, D).  cones : ConeArrays."""
    parent, offset, dof_joint, dof_axis, dof_column = chain
    joint, first, last = cones.joint, cones.start, cones.end
    R = np.empty((parent.shape[0], 3, 3))
    t = np.empty((parent.shape[0], 3))
    for n in range(states.shape[0]):
        forward_kinematics(states[n], parent, offset, dof_joint, dof_axis, dof_column, R, t)
        for k in range(joint.shape[0]):
            j = joint[k]
            for r in range(3):
                a, b, c = R[j, r, 0], R[j, r, 1], R[j, r, 2]
                start[n, k, r] = a * first[k, 0] + b * first[k, 1] + c * first[k, 2] + t[j, r]
                end[n, k, r] = a * last[k, 0] + b * last[k, 1] + c * last[k, 2] + t[j, r]


@njit(cache=True, nogil=True)
def chain_axes(state, chain, R, t, axes):
    """Joint transforms, and the world direction of every rotation axis, axes (n_dofs, 3)."""
    parent, offset, dof_joint, dof_axis, dof_column = chain
    forward_kinematics(state, parent, offset, dof_joint, dof_axis, dof_column, R, t)
    M = np.empty((3, 3))
    for d in range(dof_joint.shape[0]):
        j = dof_joint[d]
        if d == 0 or dof_joint[d - 1] != j:
            p = parent[j]
            for r in range(3):
                for c in range(3):
                    if p < 0:
                        M[r, c] = 1.0 if r == c else 0.0
                    else:
                        M[r, c] = R[p, r, c]
        for r in range(3):
            axes[d, r] = M[r, dof_axis[d]]
        co = math.cos(state[dof_column[d]])
        si = math.sin(state[dof_column[d]])
        a = (dof_axis[d] + 1) % 3
        b = (dof_axis[d] + 2) % 3
        for r in range(3):
            va = M[r, a]
            vb = M[r, b]
            M[r, a] = co * va + si * vb
            M[r, b] = -si * va + co * vb


@njit(cache=True, nogil=True)
def points_and_derivatives(state, body, joint, offset, R, t, points, derivatives):
    """Places (K, 3) of points on joints at a state (D,) and their derivatives (K, 3, D), zero before; and R, t of the
    joints.

    body : BodyArrays.  offset : (K, 3) in the frames of the joints (K,).
    """
    chain, moves = body.chain, body.moves
    dof_joint, dof_column = chain.dof_joint, chain.dof_column
    axes = np.empty((dof_joint.shape[0], 3))
    chain_axes(state, chain, R, t, axes)
    for k in range(joint.shape[0]):
        j = joint[k]
        for r in range(3):
            points[k, r] = (
                R[j, r, 0] * offset[k, 0] + R[j, r, 1] * offset[k, 1] + R[j, r, 2] * offset[k, 2] + t[j, r]
            )
            derivatives[k, r, r] += 1.0
        for d in range(dof_joint.shape[0]):
            if not moves[j, d]:
                continue
            q, column = dof_joint[d], dof_column[d]
            x = points[k, 0] - t[q, 0]
            y = points[k, 1] - t[q, 1]
            z = points[k, 2] - t[q, 2]
            derivatives[k, 0, column] += axes[d, 1] * z - axes[d, 2] * y
            derivatives[k, 1, column] += axes[d, 2] * x - axes[d, 0] * z
            derivatives[k, 2, column] += axes[d, 0] * y - axes[d, 1] * x


@njit(cache=True, nogil=True)
def cones_on_lattice(origin, spacing, start, end, radii, round_ends, inside, deepest):
    """Which points of a lattice lie in each truncated cone.

    inside : (K, nx, ny, nz) bool, False before.  deepest : (nx, ny, nz), -1 before; the cone in which a point lies
    deepest, relative to the cone's larger radius, so that thick parts do not swallow thin ones. Distances are those of
    `flesh.cone_distances`.
    """
    _, nx, ny, nz = inside.shape
    best = np.full((nx, ny, nz), np.inf)
    for k in range(start.shape[0]):
        reach = max(radii[k, 0], radii[k, 1])
        low = np.empty(3, dtype=np.int64)
        high = np.empty(3, dtype=np.int64)
        length = 0.0
        for c in range(3):
            lower = min(start[k, c], end[k, c]) - reach - 1e-9 - origin[c]
            upper = max(start[k, c], end[k, c]) + reach + 1e-9 - origin[c]
            low[c] = max(0, math.ceil(lower / spacing))
            high[c] = min(inside.shape[c + 1] - 1, math.floor(upper / spacing))
            length += (end[k, c] - start[k, c]) ** 2
        length = math.sqrt(length)
        safe = max(length, 1e-12)
        u0 = (end[k, 0] - start[k, 0]) / safe
        u1 = (end[k, 1] - start[k, 1]) / safe
        u2 = (end[k, 2] - start[k, 2]) / safe
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for m in range(low[2], high[2] + 1):
                    x = origin[0] + i * spacing - start[k, 0]
                    y = origin[1] + j * spacing - start[k, 1]
                    z = origin[2] + m * spacing - start[k, 2]
                    along = (x * u0 + y * u1 + z * u2) / safe
                    clamped = min(max(along, 0.0), 1.0)
                    radius = radii[k, 0] + clamped * (radii[k, 1] - radii[k, 0])
                    foot = (clamped if round_ends else along) * length
                    d0 = x - foot * u0
                    d1 = y - foot * u1
                    d2 = z - foot * u2
                    distance = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2) - radius
                    if not round_ends:
                        beyond = max(-along, along - 1.0) * length
                        if beyond > 0.0:
                            distance = max(distance, beyond)
                    if distance <= 0.0:
                        inside[k, i, j, m] = True
                        if distance / reach < best[i, j, m]:
                            best[i, j, m] = distance / reach
                            deepest[i, j, m] = k
