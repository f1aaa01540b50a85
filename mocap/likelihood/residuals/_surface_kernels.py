"""Normal equations of the distance between a posed body and the surface of the hull."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mocap.likelihood.residuals._nearest_kernels import deepest_in_cones, nearest_to_points
from mocap.likelihood.residuals._pull_kernels import (
    FleshPoints,
    add_pull,
    from_axis,
    place_body,
    robust_loss,
    spread_pulls,
    taper_of,
)
from mocap.likelihood.voxels.exact import OCCUPIED_BIT


class Blocks(NamedTuple):
    """Points sorted by the cube they lie in: those of cube b are rows[first[b] : first[b + 1]].

    low : (3,) m, corner of the first cube.  side : m.  shape : (3,) cubes.  first : (B + 1,).  rows : (N,).
    """

    low: NDArray[np.float64]
    side: float
    shape: NDArray[np.int64]
    first: NDArray[np.int64]
    rows: NDArray[np.int64]


class HullPoints(NamedTuple):
    """Surface of a hull.  points, normals : (M, 3) m, those that pull.  columns : (6, M), both as `nearest_to_points`
    takes them.  every : (N, 3) m, all, sorted into blocks."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    columns: NDArray[np.float32]
    every: NDArray[np.float64]
    blocks: Blocks


class Volume(NamedTuple):
    """A packed volume.  crop : (nx, ny, nz) uint8.  lower_m : (3,) m, its corner.  voxel_m : side of a voxel."""

    crop: NDArray[np.uint8]
    lower_m: NDArray[np.float64]
    voxel_m: float


class SurfacePull(NamedTuple):
    """How hull and flesh pull each other: `SurfaceFitSettings`, with gains per point.  excess_m : by how much the hull
    lies outside the flesh that it fits."""

    excess_m: float
    scale_m: float
    normal_cost_m: float
    flesh_scale_m: float
    flesh_gain: float
    penetration_gain: float
    floor_scale_m: float
    floor_gain: float


class SurfaceTerms(NamedTuple):
    """Everything of one frame that `surface_equations` takes.  may_meet : (P, M) bool, parts that a flesh point is
    tested against."""

    hull: HullPoints
    flesh: FleshPoints
    may_meet: NDArray[np.bool_]
    volume: Volume
    pull: SurfacePull


@njit(cache=True, nogil=True)
def is_occupied(crop, x, y, z):
    """Whether a voxel of a packed volume is occupied; none is beyond it."""
    if x < 0 or y < 0 or z < 0 or x >= crop.shape[0] or y >= crop.shape[1] or z >= crop.shape[2]:
        return False
    return crop[x, y, z] >= OCCUPIED_BIT


@njit(cache=True, nogil=True)
def hull_to_body(hull, placed, cones, pull, pulls):
    """Pull the nearest flesh to every hull surface point; returns the robust cost.

    The nearest cone is chosen by distance and by the angle between the outward normals.
    """
    # Unpacked once: taken from a tuple inside the loop each array would cost a reference count.
    points, normals, start, end = hull.points, hull.normals, placed.start, placed.end
    radii, cone_joint = cones.radii, cones.joint
    excess, scale = pull.excess_m, pull.scale_m
    nearest = nearest_to_points(hull.columns, placed, radii, excess, pull.normal_cost_m)
    cost = 0.0
    for i in range(points.shape[0]):
        k = nearest[i]
        at = (points[i, 0], points[i, 1], points[i, 2])
        s, dx, dy, dz = from_axis(at, start, end, k)
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        inv = 1.0 / max(length, 1e-9)
        cosine = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) * inv
        widening = radii[k, 1] - radii[k, 0]
        r = length - (radii[k, 0] + s * widening) - excess
        loss, weight = robust_loss(r, scale, 1.0)
        cost += loss
        weight *= max(cosine, 0.0)
        if weight > 1e-4:
            # d(residual) = -(gradient of the distance) . dx: it shrinks when the flesh moves outwards.
            t = taper_of(start, end, k, widening, s)
            n = (t[0] - dx * inv, t[1] - dy * inv, t[2] - dz * inv)
            add_pull(at, n, r, weight, cone_joint[k], pulls)
    return cost


@njit(cache=True, nogil=True)
def sort_into_blocks(points, blocks):
    """Fill first and rows of the blocks of points (N, 3)."""
    low, side, shape, first, rows = blocks
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
def _nearest_of(at, points, rows, best, row):
    """Square of the distance to the nearest of some rows of points and that row, if it is below `best`, else these."""
    for i in rows:
        dx = points[i, 0] - at[0]
        dy = points[i, 1] - at[1]
        dz = points[i, 2] - at[2]
        square = dx * dx + dy * dy + dz * dz
        if square < best:
            best = square
            row = i
    return best, row


@njit(cache=True, nogil=True)
def nearest_in_blocks(at, points, blocks):
    """Row of the point nearest to a place, three numbers; the blocks are those of `sort_into_blocks`. At least one
    point."""
    low, side, shape, first, rows = blocks
    u = (at[0] - low[0]) / side
    v = (at[1] - low[1]) / side
    w = (at[2] - low[2]) / side
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
                    best, row = _nearest_of(at, points, rows[first[b] : first[b + 1]], best, row)
        # All that was not looked at lies further than this.
        clear = (shell + spare) * side
        if best <= clear * clear:
            return row
        shell += 1


@njit(cache=True, nogil=True)
def body_to_hull(flesh, flesh_joint, surface, pulls):
    """Pull flesh points (M, 3) that stick out of the hull back to the nearest hull point; returns the robust cost.

    surface : SurfaceTerms.
    """
    crop, lower_m, voxel = surface.volume
    hull_points, blocks = surface.hull.every, surface.hull.blocks
    scale, gain = surface.pull.flesh_scale_m, surface.pull.flesh_gain
    cost = 0.0
    for i in range(flesh.shape[0]):
        x = flesh[i, 0]
        y = flesh[i, 1]
        z = flesh[i, 2]
        ix = math.floor((x - lower_m[0]) / voxel)
        iy = math.floor((y - lower_m[1]) / voxel)
        iz = math.floor((z - lower_m[2]) / voxel)
        if is_occupied(crop, ix, iy, iz):
            continue
        row = nearest_in_blocks((x, y, z), hull_points, blocks)
        nx = x - hull_points[row, 0]
        ny = y - hull_points[row, 1]
        nz = z - hull_points[row, 2]
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if length < 1e-9:
            continue
        loss, weight = robust_loss(length, scale, gain)
        cost += loss
        n = (nx / length, ny / length, nz / length)
        add_pull((x, y, z), n, length, weight, flesh_joint[i], pulls)
    return cost


@njit(cache=True, nogil=True)
def body_to_floor(placed, cones, pull, pulls):
    """Lift the flesh at the ends of cones that lie below the floor, z = 0; returns the robust cost."""
    radii, cone_joint = cones.radii, cones.joint
    cost = 0.0
    for i in range(2 * radii.shape[0]):
        k, end = i // 2, i % 2
        axis = placed.end if end else placed.start
        height = axis[k, 2] - radii[k, end]
        if height < 0.0:
            loss, weight = robust_loss(height, pull.floor_scale_m, pull.floor_gain)
            cost += loss
            add_pull((axis[k, 0], axis[k, 1], height), (0.0, 0.0, 1.0), height, weight, cone_joint[k], pulls)
    return cost


@njit(cache=True, nogil=True)
def surface_equations(state, body, surface, H, g):
    """Robust cost of a state (D,); adds its normal equations to H (D, D) and g (D,).

    body : BodyArrays.  surface : SurfaceTerms.
    """
    placed = place_body(state, body, surface.flesh)
    joint = surface.flesh.joint
    pulls = np.zeros((placed.t.shape[0], 7, 6))
    cost = hull_to_body(surface.hull, placed, body.cones, surface.pull, pulls)
    cost += body_to_hull(placed.flesh, joint, surface, pulls)
    cost += body_to_floor(placed, body.cones, surface.pull, pulls)
    gain = surface.pull.penetration_gain
    if gain > 0.0:
        cost += self_penetration(placed, joint, surface.may_meet, body, gain, H, g)
    spread_pulls(pulls, body, placed.t, placed.axes, H, g)
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
        for x in range(max(ix - radius, 0), min(ix + radius + 1, crop.shape[0])):
            for y in range(max(iy - radius, 0), min(iy + radius + 1, crop.shape[1])):
                n = 0
                for z in range(max(iz - radius, 0), min(iz + radius + 1, crop.shape[2])):
                    occupied = crop[x, y, z] >> 7
                    n += occupied
                    sz -= occupied * (z - iz)
                sx -= n * (x - ix)
                sy -= n * (y - iy)
        length = math.sqrt(sx * sx + sy * sy + sz * sz)
        if length > 1e-9:
            normals[m, 0] = sx / length
            normals[m, 1] = sy / length
            normals[m, 2] = sz / length
        m += 1


@njit(cache=True, nogil=True)
def self_penetration(placed, point_joint, may_meet, body, gain, H, g):
    """Push flesh points out of the cones of other parts; returns the cost.

    may_meet : (P, M) bool, parts that a point is tested against. The derivative is that of the relative movement
    of the two parts.
    """
    t, axes, start, end, points = placed
    radii, cone_joint = body.cones.radii, body.cones.joint
    dof_joint, dof_column, moves = body.chain.dof_joint, body.chain.dof_column, body.moves
    n_dofs = dof_joint.shape[0]
    values = np.empty(n_dofs)
    used = np.empty(n_dofs, np.int64)
    deepest_in = deepest_in_cones(points, may_meet, placed, body.cones)
    cost = 0.0
    for i in range(points.shape[0]):
        other = deepest_in[i]
        if other < 0:
            continue
        at = (points[i, 0], points[i, 1], points[i, 2])
        s, dx, dy, dz = from_axis(at, start, end, other)
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        n = (-dx / length, -dy / length, -dz / length)
        deepest = radii[other, 0] + s * (radii[other, 1] - radii[other, 0]) - length
        cost += 0.5 * gain * deepest * deepest
        ja = point_joint[i]
        jb = cone_joint[other]
        m = 0
        for d in range(n_dofs):
            # A rotation that moves both parts leaves their distance as it is.
            if moves[ja, d] == moves[jb, d]:
                continue
            q = t[dof_joint[d]]
            rx = at[0] - q[0]
            ry = at[1] - q[1]
            rz = at[2] - q[2]
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
        at = (points[i, 0], points[i, 1], points[i, 2])
        best = np.inf
        for k in range(start.shape[0]):
            s, dx, dy, dz = from_axis(at, start, end, k)
            d = math.sqrt(dx * dx + dy * dy + dz * dz) - (radii[k, 0] + s * (radii[k, 1] - radii[k, 0]))
            best = min(best, d)
        distance[i] = best


@njit(cache=True, nogil=True)
def share_within(points, start, end, reach, share):
    """Share of the points (U, 3) that lie within reach (K,) of an axis of N particles, start, end (N, K, 3)."""
    for i in range(start.shape[0]):
        own_start, own_end = start[i], end[i]
        n = 0
        for u in range(points.shape[0]):
            at = (points[u, 0], points[u, 1], points[u, 2])
            for k in range(own_start.shape[0]):
                _, dx, dy, dz = from_axis(at, own_start, own_end, k)
                if dx * dx + dy * dy + dz * dz < reach[k] * reach[k]:
                    n += 1
                    break
        share[i] = n / max(points.shape[0], 1)
