"""Normal equations of the distance between a posed body and the surface of the hull."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mocap.likelihood.residuals._pull_kernels import add_pull, posed, robust_loss, spread_pulls
from mocap.likelihood.voxels.exact import OCCUPIED_BIT


@njit(cache=True, nogil=True)
def hull_to_body(points, normals, start, end, radii, cone_joint, excess, scale, normal_cost, pulls):
    """Pull the nearest flesh to every hull surface point; returns the robust cost.

    The nearest cone is chosen by distance and by the angle between the outward normals.
    """
    n_cones = start.shape[0]
    cost = 0.0
    # Bounding spheres of the cones: most are out of the question at a glance.
    middle = 0.5 * (start + end)
    axis = end - start
    reach = np.empty(n_cones)
    squared = np.empty(n_cones)
    for k in range(n_cones):
        squared[k] = axis[k, 0] ** 2 + axis[k, 1] ** 2 + axis[k, 2] ** 2 + 1e-12
        reach[k] = 0.5 * math.sqrt(squared[k]) + max(radii[k, 0], radii[k, 1]) + excess
    hint = 0
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        best = np.inf
        best_root = np.inf
        best_r = 0.0
        best_k = -1
        best_cos = 0.0
        nx = 0.0
        ny = 0.0
        nz = 0.0
        taper = 0.0
        # The cone of the point before goes first: points next to each other mostly share theirs.
        for order in range(n_cones + 1):
            k = hint if order == 0 else order - 1
            if order > 0 and k == hint:
                continue
            limit = reach[k] + best_root
            mx = x - middle[k, 0]
            my = y - middle[k, 1]
            mz = z - middle[k, 2]
            if mx * mx + my * my + mz * mz > limit * limit:
                continue
            px = x - start[k, 0]
            py = y - start[k, 1]
            pz = z - start[k, 2]
            along = (px * axis[k, 0] + py * axis[k, 1] + pz * axis[k, 2]) / squared[k]
            s = min(max(along, 0.0), 1.0)
            dx = px - s * axis[k, 0]
            dy = py - s * axis[k, 1]
            dz = pz - s * axis[k, 2]
            length = math.sqrt(dx * dx + dy * dy + dz * dz)
            r = length - (radii[k, 0] + s * (radii[k, 1] - radii[k, 0])) - excess
            if r * r >= best:
                continue
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
                nx = dx * inv
                ny = dy * inv
                nz = dz * inv
                # Beside the cone the radius changes along the axis; beyond its ends it does not.
                taper = (radii[k, 1] - radii[k, 0]) / squared[k] if s == along else 0.0
        hint = best_k
        loss, weight = robust_loss(best_r, scale, 1.0)
        cost += loss
        weight *= max(best_cos, 0.0)
        if weight > 1e-4:
            # d(residual) = -(gradient of the distance) . dx: it shrinks when the flesh moves outwards.
            add_pull(
                x,
                y,
                z,
                taper * axis[best_k, 0] - nx,
                taper * axis[best_k, 1] - ny,
                taper * axis[best_k, 2] - nz,
                best_r,
                weight,
                cone_joint[best_k],
                pulls,
            )
    return cost


@njit(cache=True, nogil=True)
def sort_into_blocks(points, low, side, shape, first, rows):
    """Rows of points (N, 3) by the cube they lie in: those of cube b are rows[first[b] : first[b + 1]].

    low : (3,) m, corner of the first cube.  side : m.  shape : (3,) cubes.  first : (B + 1,), rows : (N,) filled.
    """
    n = points.shape[0]
    block = np.empty(n, np.int64)
    first[:] = 0
    for i in range(n):
        b = 0
        for c in range(3):
            b = b * shape[c] + min(max(math.floor((points[i, c] - low[c]) / side), 0), shape[c] - 1)
        block[i] = b
        first[b + 1] += 1
    for b in range(first.shape[0] - 1):
        first[b + 1] += first[b]
    cursor = first[:-1].copy()
    for i in range(n):
        rows[cursor[block[i]]] = i
        cursor[block[i]] += 1


@njit(cache=True, nogil=True)
def nearest_in_blocks(x, y, z, points, low, side, shape, first, rows):
    """Row of the point nearest to (x, y, z); the blocks are those of `sort_into_blocks`. At least one point."""
    u = (x - low[0]) / side
    v = (y - low[1]) / side
    w = (z - low[2]) / side
    own_x = math.floor(u)
    own_y = math.floor(v)
    own_z = math.floor(w)
    # How far the place lies from the nearest face of its own cube.
    spare = min(
        min(min(u - own_x, own_x + 1 - u), min(v - own_y, own_y + 1 - v)), min(w - own_z, own_z + 1 - w)
    )
    shell = max(
        max(max(-own_x, own_x - shape[0] + 1), max(-own_y, own_y - shape[1] + 1)),
        max(max(-own_z, own_z - shape[2] + 1), 0),
    )
    best = np.inf
    row = 0
    while True:
        for ix in range(max(own_x - shell, 0), min(own_x + shell + 1, shape[0])):
            at_x = abs(ix - own_x) == shell
            for iy in range(max(own_y - shell, 0), min(own_y + shell + 1, shape[1])):
                stride = 1 if at_x or abs(iy - own_y) == shell else max(2 * shell, 1)
                for iz in range(own_z - shell, own_z + shell + 1, stride):
                    if iz < 0 or iz >= shape[2]:
                        continue
                    b = (ix * shape[1] + iy) * shape[2] + iz
                    for at in range(first[b], first[b + 1]):
                        i = rows[at]
                        dx = points[i, 0] - x
                        dy = points[i, 1] - y
                        dz = points[i, 2] - z
                        square = dx * dx + dy * dy + dz * dz
                        if square < best:
                            best = square
                            row = i
        # All that was not looked at lies further than this.
        clear = (shell + spare) * side
        if best <= clear * clear:
            return row
        shell += 1


@njit(cache=True, nogil=True)
def body_to_hull(flesh, flesh_joint, crop, lower_m, voxel, hull_points, blocks, scale, gain, pulls):
    """Pull flesh points that stick out of the hull back to the nearest hull point; returns the robust cost.

    blocks : (low, side, shape, first, rows) of the hull points, from `sort_into_blocks`.
    """
    low, side, shape, first, rows = blocks
    cost = 0.0
    for i in range(flesh.shape[0]):
        x = flesh[i, 0]
        y = flesh[i, 1]
        z = flesh[i, 2]
        ix = math.floor((x - lower_m[0]) / voxel)
        iy = math.floor((y - lower_m[1]) / voxel)
        iz = math.floor((z - lower_m[2]) / voxel)
        if (
            0 <= ix < crop.shape[0]
            and 0 <= iy < crop.shape[1]
            and 0 <= iz < crop.shape[2]
            and crop[ix, iy, iz] >= OCCUPIED_BIT
        ):
            continue
        row = nearest_in_blocks(x, y, z, hull_points, low, side, shape, first, rows)
        nx = x - hull_points[row, 0]
        ny = y - hull_points[row, 1]
        nz = z - hull_points[row, 2]
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if length < 1e-9:
            continue
        loss, weight = robust_loss(length, scale, gain)
        cost += loss
        add_pull(x, y, z, nx / length, ny / length, nz / length, length, weight, flesh_joint[i], pulls)
    return cost


@njit(cache=True, nogil=True)
def surface_equations(
    state, chain, moves, cones, hull, flesh_points, flesh_joint, may_meet, volume, settings, H, g
):
    """Robust cost of a state; adds its normal equations to H (D, D) and g (D,).

    chain : of the body.  cones : (start, end, radii, joint, part).  hull : (points, normals, all surface
    points, their blocks).
    volume : (crop, lower_m, voxel).  settings : (excess, scale, normal_cost, flesh_scale, flesh_gain,
    penetration_gain).
    """
    parent, _, dof_joint, _, dof_column = chain
    _, _, radii, cone_joint, cone_part = cones
    points, normals, all_points, blocks = hull
    crop, lower_m, voxel = volume
    excess, scale, normal_cost, flesh_scale, flesh_gain, penetration_gain = settings
    t, axes, start, end, flesh = posed(state, chain, cones, flesh_points, flesh_joint)
    pulls = np.zeros((t.shape[0], 7, 6))
    cost = hull_to_body(points, normals, start, end, radii, cone_joint, excess, scale, normal_cost, pulls)
    cost += body_to_hull(
        flesh, flesh_joint, crop, lower_m, voxel, all_points, blocks, flesh_scale, flesh_gain, pulls
    )
    if penetration_gain > 0.0:
        moving = (t, axes, dof_joint, dof_column, moves)
        cost += self_penetration(
            flesh,
            flesh_joint,
            may_meet,
            start,
            end,
            radii,
            cone_joint,
            cone_part,
            moving,
            penetration_gain,
            H,
            g,
        )
    spread_pulls(pulls, parent, t, axes, dof_joint, dof_column, moves, H, g)
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
