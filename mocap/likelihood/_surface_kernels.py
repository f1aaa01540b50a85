"""Normal equations of the distance between a posed body and the surface of the hull."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mocap.body._kernels import forward_kinematics


@njit(cache=True, nogil=True)
def chain_axes(state, parent, offset, dof_joint, dof_axis, dof_column, R, t, axes):
    """Joint transforms, and the world direction of every rotation axis, axes (n_dofs, 3)."""
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
def robust_loss(residual, scale, gain):
    """Geman-McClure cost of a residual, and its weight in the normal equations."""
    q = residual / scale
    s = 1.0 + q * q
    return gain * 0.5 * scale * scale * q * q / s, gain / (s * s)


@njit(cache=True, nogil=True)
def add_row(x, n, residual, weight, j, moving, columns, values, H, g):
    """Add one scalar residual whose derivative is n . dx/dstate, x rigid with joint j, to H and g.

    moving : (t, axes, dof_joint, dof_column, moves), what the rotations move and about which axes.
    """
    t, axes, dof_joint, dof_column, moves = moving
    k = 0
    for c in range(3):
        columns[k] = c
        values[k] = n[c]
        k += 1
    for d in range(dof_joint.shape[0]):
        if not moves[j, d]:
            continue
        q = t[dof_joint[d]]
        rx = x[0] - q[0]
        ry = x[1] - q[1]
        rz = x[2] - q[2]
        vx = axes[d, 1] * rz - axes[d, 2] * ry
        vy = axes[d, 2] * rx - axes[d, 0] * rz
        vz = axes[d, 0] * ry - axes[d, 1] * rx
        columns[k] = dof_column[d]
        values[k] = n[0] * vx + n[1] * vy + n[2] * vz
        k += 1
    for a in range(k):
        wa = weight * values[a]
        g[columns[a]] += wa * residual
        for b in range(k):
            H[columns[a], columns[b]] += wa * values[b]


@njit(cache=True, nogil=True)
def hull_to_body(
    points,
    normals,
    start,
    end,
    radii,
    cone_joint,
    moving,
    excess,
    scale,
    normal_cost,
    H,
    g,
):
    """Pull the nearest flesh to every hull surface point; returns the robust cost.

    The nearest cone is chosen by distance and by the angle between the outward normals.
    """
    n_cones = start.shape[0]
    columns = np.empty(H.shape[0], np.int64)
    values = np.empty(H.shape[0])
    foot = np.empty(3)
    best_n = np.empty(3)
    slope = np.empty(3)
    n = np.empty(3)
    cost = 0.0
    # Bounding spheres of the cones: most are out of the question at a glance.
    middle = 0.5 * (start + end)
    reach = np.empty(n_cones)
    for k in range(n_cones):
        length = 0.0
        for c in range(3):
            length += (end[k, c] - start[k, c]) ** 2
        reach[k] = 0.5 * math.sqrt(length) + max(radii[k, 0], radii[k, 1]) + excess
    for i in range(points.shape[0]):
        best = np.inf
        best_root = np.inf
        best_r = 0.0
        best_k = -1
        best_cos = 0.0
        for k in range(n_cones):
            limit = reach[k] + best_root
            mx = points[i, 0] - middle[k, 0]
            my = points[i, 1] - middle[k, 1]
            mz = points[i, 2] - middle[k, 2]
            if mx * mx + my * my + mz * mz > limit * limit:
                continue
            ax = end[k, 0] - start[k, 0]
            ay = end[k, 1] - start[k, 1]
            az = end[k, 2] - start[k, 2]
            px = points[i, 0] - start[k, 0]
            py = points[i, 1] - start[k, 1]
            pz = points[i, 2] - start[k, 2]
            squared = ax * ax + ay * ay + az * az + 1e-12
            along = (px * ax + py * ay + pz * az) / squared
            s = min(max(along, 0.0), 1.0)
            foot[0] = start[k, 0] + s * ax
            foot[1] = start[k, 1] + s * ay
            foot[2] = start[k, 2] + s * az
            dx = points[i, 0] - foot[0]
            dy = points[i, 1] - foot[1]
            dz = points[i, 2] - foot[2]
            length = math.sqrt(dx * dx + dy * dy + dz * dz)
            radius = radii[k, 0] + s * (radii[k, 1] - radii[k, 0])
            r = length - radius - excess
            inv = 1.0 / max(length, 1e-9)
            cosine = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) * inv
            miss = normal_cost * (1.0 - cosine)
            score = r * r + miss * miss
            if score < best:
                best = score
                best_root = math.sqrt(score)
                best_r = r
                best_k = k
                best_cos = cosine
                best_n[0] = dx * inv
                best_n[1] = dy * inv
                best_n[2] = dz * inv
                # Beside the cone the radius changes along the axis; beyond its ends it does not.
                taper = (radii[k, 1] - radii[k, 0]) / squared if s == along else 0.0
                slope[0] = taper * ax
                slope[1] = taper * ay
                slope[2] = taper * az
        loss, weight = robust_loss(best_r, scale, 1.0)
        cost += loss
        weight *= max(best_cos, 0.0)
        if weight > 1e-4:
            # d(residual) = -(gradient of the distance) . dx: it shrinks when the flesh moves outwards.
            for c in range(3):
                n[c] = slope[c] - best_n[c]
            add_row(points[i], n, best_r, weight, cone_joint[best_k], moving, columns, values, H, g)
    return cost


@njit(cache=True, nogil=True)
def body_to_hull(points, point_joint, nearest, outside, moving, scale, gain, H, g):
    """Pull flesh points that stick out of the hull back to the nearest hull point; returns the robust cost."""
    columns = np.empty(H.shape[0], np.int64)
    values = np.empty(H.shape[0])
    n = np.empty(3)
    cost = 0.0
    for i in range(points.shape[0]):
        if not outside[i]:
            continue
        length = 0.0
        for c in range(3):
            n[c] = points[i, c] - nearest[i, c]
            length += n[c] * n[c]
        length = math.sqrt(length)
        if length < 1e-9:
            continue
        for c in range(3):
            n[c] /= length
        loss, weight = robust_loss(length, scale, gain)
        cost += loss
        add_row(points[i], n, length, weight, point_joint[i], moving, columns, values, H, g)
    return cost


@njit(cache=True, nogil=True)
def surface_normals(voxels, is_surface, crop, lower, ny, nz, radius, normals):
    """Outward normals of surface voxels: away from the mean of the occupied voxels around."""
    m = 0
    for i in range(voxels.shape[0]):
        if not is_surface[i]:
            continue
        iz = voxels[i] % nz - lower[2]
        iy = (voxels[i] // nz) % ny - lower[1]
        ix = voxels[i] // nz // ny - lower[0]
        sx = 0.0
        sy = 0.0
        sz = 0.0
        for dx in range(-radius, radius + 1):
            for dy in range(-radius, radius + 1):
                for dz in range(-radius, radius + 1):
                    x = ix + dx
                    y = iy + dy
                    z = iz + dz
                    if (
                        x >= 0
                        and y >= 0
                        and z >= 0
                        and x < crop.shape[0]
                        and y < crop.shape[1]
                        and z < crop.shape[2]
                        and crop[x, y, z] >= 128
                    ):
                        sx -= dx
                        sy -= dy
                        sz -= dz
        length = math.sqrt(sx * sx + sy * sy + sz * sz)
        if length > 1e-9:
            normals[m, 0] = sx / length
            normals[m, 1] = sy / length
            normals[m, 2] = sz / length
        m += 1


@njit(cache=True, nogil=True)
def self_penetration(
    points,
    point_joint,
    may_meet,
    start,
    end,
    radii,
    cone_joint,
    cone_part,
    moving,
    gain,
    H,
    g,
):
    """Push flesh points out of the cones of other parts; returns the cost.

    may_meet : (M, P) bool, parts that a point is tested against. The derivative is that of the relative movement
    of the two parts.
    """
    t, axes, dof_joint, dof_column, moves = moving
    n_dofs = dof_joint.shape[0]
    values = np.empty(n_dofs)
    used = np.empty(n_dofs, np.int64)
    n = np.empty(3)
    cost = 0.0
    for i in range(points.shape[0]):
        deepest = 0.0
        other = -1
        for k in range(start.shape[0]):
            if not may_meet[i, cone_part[k]]:
                continue
            ax = end[k, 0] - start[k, 0]
            ay = end[k, 1] - start[k, 1]
            az = end[k, 2] - start[k, 2]
            px = points[i, 0] - start[k, 0]
            py = points[i, 1] - start[k, 1]
            pz = points[i, 2] - start[k, 2]
            s = (px * ax + py * ay + pz * az) / (ax * ax + ay * ay + az * az + 1e-12)
            s = min(max(s, 0.0), 1.0)
            dx = px - s * ax
            dy = py - s * ay
            dz = pz - s * az
            radius = radii[k, 0] + s * (radii[k, 1] - radii[k, 0])
            square = dx * dx + dy * dy + dz * dz
            if square >= radius * radius:
                continue
            length = math.sqrt(square)
            depth = radius - length
            if depth > deepest and length > 1e-6:
                deepest = depth
                other = k
                n[0] = -dx / length
                n[1] = -dy / length
                n[2] = -dz / length
        if other < 0:
            continue
        cost += 0.5 * gain * deepest * deepest
        ja = point_joint[i]
        jb = cone_joint[other]
        m = 0
        for d in range(n_dofs):
            # A rotation that moves both parts leaves their distance as it is.
            if moves[ja, d] == moves[jb, d]:
                continue
            q = t[dof_joint[d]]
            rx = points[i, 0] - q[0]
            ry = points[i, 1] - q[1]
            rz = points[i, 2] - q[2]
            v = (
                n[0] * (axes[d, 1] * rz - axes[d, 2] * ry)
                + n[1] * (axes[d, 2] * rx - axes[d, 0] * rz)
                + n[2] * (axes[d, 0] * ry - axes[d, 1] * rx)
            )
            values[m] = v if moves[ja, d] else -v
            used[m] = dof_column[d]
            m += 1
        for a in range(m):
            wa = gain * values[a]
            g[used[a]] += wa * deepest
            for b in range(m):
                H[used[a], used[b]] += wa * values[b]
    return cost


@njit(cache=True, nogil=True)
def distance_to_cones(points, start, end, radii, distance):
    """Distance of each point to the nearest cone, negative inside."""
    for i in range(points.shape[0]):
        best = np.inf
        for k in range(start.shape[0]):
            ax = end[k, 0] - start[k, 0]
            ay = end[k, 1] - start[k, 1]
            az = end[k, 2] - start[k, 2]
            px = points[i, 0] - start[k, 0]
            py = points[i, 1] - start[k, 1]
            pz = points[i, 2] - start[k, 2]
            s = (px * ax + py * ay + pz * az) / (ax * ax + ay * ay + az * az + 1e-12)
            s = min(max(s, 0.0), 1.0)
            dx = px - s * ax
            dy = py - s * ay
            dz = pz - s * az
            d = math.sqrt(dx * dx + dy * dy + dz * dz) - (radii[k, 0] + s * (radii[k, 1] - radii[k, 0]))
            best = min(best, d)
        distance[i] = best


@njit(cache=True, nogil=True)
def share_within(points, start, end, reach, share):
    """Share of the points (U, 3) that lie within reach (K,) of an axis of N particles, start, end (N, K, 3)."""
    for i in range(start.shape[0]):
        n = 0
        for u in range(points.shape[0]):
            for k in range(start.shape[1]):
                ax = end[i, k, 0] - start[i, k, 0]
                ay = end[i, k, 1] - start[i, k, 1]
                az = end[i, k, 2] - start[i, k, 2]
                px = points[u, 0] - start[i, k, 0]
                py = points[u, 1] - start[i, k, 1]
                pz = points[u, 2] - start[i, k, 2]
                s = (px * ax + py * ay + pz * az) / (ax * ax + ay * ay + az * az + 1e-12)
                s = min(max(s, 0.0), 1.0)
                dx = px - s * ax
                dy = py - s * ay
                dz = pz - s * az
                if dx * dx + dy * dy + dz * dz < reach[k] * reach[k]:
                    n += 1
                    break
        share[i] = n / max(points.shape[0], 1)
