"""Forward kinematics as compiled code; the honest twin is `kinematics.transforms_by_exponentials`."""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True, nogil=True)
def forward_kinematics(state, parent, offset, dof_joint, dof_axis, dof_column, R, t):
    """Fill R (J, 3, 3) and t (J, 3), joint frame to world, of one state (D,); columns 0..2 are the root.

    dof_* : one row per rotation in the order of application along the chain; axis 0, 1, 2 = x, y, z.
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
def transforms_kernel(states, parent, offset, dof_joint, dof_axis, dof_column, R, t):
    """Joint transforms of many states (N, D) into R (N, J, 3, 3), t (N, J, 3)."""
    for n in range(states.shape[0]):
        forward_kinematics(states[n], parent, offset, dof_joint, dof_axis, dof_column, R[n], t[n])
