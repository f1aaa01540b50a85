"""The cone of the flesh that is nearest to each of many points or rays: loops over all of them, cone by cone.

Only the choice is made here, in single precision; what follows from it is computed by the caller, in double. A loop is
free of branches and its arrays are read at its own counter, so that one instruction works on sixteen points: three to
eight times as fast as a search that passes over far cones point by point.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_TINY = np.float32(1e-9)
_THIN = np.float32(1e-6)  # m; a direction from an axis that is so near is none
_PARALLEL = np.float32(1e-6)  # of the axis' squared length: what single precision can tell of an angle
_FAR = np.float32(np.inf)


@njit(cache=True, nogil=True)
def in_columns(points):
    """Points (M, 3) coordinate by coordinate, (3, M), in single precision."""
    columns = np.empty((3, points.shape[0]), np.float32)
    for i in range(points.shape[0]):
        for c in range(3):
            columns[c, i] = points[i, c]
    return columns


@njit(cache=True, nogil=True)
def _cone_of(placed, radii, k):
    """A cone in single precision: its start, axis, and the inverse of the axis' squared length; two radii."""
    start, end = placed.start, placed.end
    ax = end[k, 0] - start[k, 0]
    ay = end[k, 1] - start[k, 1]
    az = end[k, 2] - start[k, 2]
    at = (np.float32(start[k, 0]), np.float32(start[k, 1]), np.float32(start[k, 2]))
    axis = (np.float32(ax), np.float32(ay), np.float32(az))
    inverse = np.float32(1.0 / (ax * ax + ay * ay + az * az + 1e-12))
    return at, axis, inverse, np.float32(radii[k, 0]), np.float32(radii[k, 1])


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_to_points(columns, placed, radii, excess, normal_cost):
    """The cone that is nearest to every point, by distance and by the angle between the outward normals, (M,).

    columns : (6, M) float32, points and normals.  placed : Placed.  radii : (K, 2) m.  excess : m, by how much the
    points lie outside the flesh that they belong to.  normal_cost : m that opposite normals are worth.
    """
    x, y, z, u, v, w = columns[0], columns[1], columns[2], columns[3], columns[4], columns[5]
    n = x.shape[0]
    best = np.full(n, _FAR, np.float32)
    nearest = np.zeros(n, np.int32)
    worth = np.float32(normal_cost)
    for k in range(radii.shape[0]):
        at, axis, inverse, first, last = _cone_of(placed, radii, k)
        first += np.float32(excess)
        taper = last + np.float32(excess) - first
        own = np.int32(k)
        for i in range(n):
            px = x[i] - at[0]
            py = y[i] - at[1]
            pz = z[i] - at[2]
            s = (px * axis[0] + py * axis[1] + pz * axis[2]) * inverse
            s = s if s > _ZERO else _ZERO
            s = s if s < _ONE else _ONE
            dx = px - s * axis[0]
            dy = py - s * axis[1]
            dz = pz - s * axis[2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz) + _TINY
            r = length - (first + s * taper)
            miss = worth * (_ONE - (dx * u[i] + dy * v[i] + dz * w[i]) / length)
            score = r * r + miss * miss
            is_nearer = score < best[i]
            best[i] = score if is_nearer else best[i]
            nearest[i] = own if is_nearer else nearest[i]
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_to_rays(columns, placed, radii, normal_cost):
    """The cone that every ray touches best, by distance and by the angle between the outline's normal and the direction
    from the cone's axis to the ray, (M,); -1 where none lies in front of the ray's origin.

    columns : (9, M) float32, origins, directions and normals.  placed, radii, normal_cost : of `nearest_to_points`.
    """
    x, y, z = columns[0], columns[1], columns[2]
    ux, uy, uz = columns[3], columns[4], columns[5]
    nx, ny, nz = columns[6], columns[7], columns[8]
    n = x.shape[0]
    best = np.full(n, _FAR, np.float32)
    nearest = np.full(n, -1, np.int32)
    worth = np.float32(normal_cost)
    for k in range(radii.shape[0]):
        at, axis, inverse, first, last = _cone_of(placed, radii, k)
        squared = _ONE / inverse
        taper = last - first
        own = np.int32(k)
        for i in range(n):
            wx = at[0] - x[i]
            wy = at[1] - y[i]
            wz = at[2] - z[i]
            au = axis[0] * ux[i] + axis[1] * uy[i] + axis[2] * uz[i]
            aw = axis[0] * wx + axis[1] * wy + axis[2] * wz
            uw = ux[i] * wx + uy[i] * wy + uz[i] * wz
            det = squared - au * au
            s = (au * uw - aw) / det
            s = s if det > _PARALLEL * squared else _HALF
            s = s if s > _ZERO else _ZERO
            s = s if s < _ONE else _ONE
            fx = wx + s * axis[0]
            fy = wy + s * axis[1]
            fz = wz + s * axis[2]
            depth = fx * ux[i] + fy * uy[i] + fz * uz[i]
            dx = depth * ux[i] - fx
            dy = depth * uy[i] - fy
            dz = depth * uz[i] - fz
            length = np.sqrt(dx * dx + dy * dy + dz * dz) + _TINY
            r = length - (first + s * taper)
            miss = worth * (_ONE - (dx * nx[i] + dy * ny[i] + dz * nz[i]) / length)
            score = r * r + miss * miss
            score = score if depth > _ZERO else _FAR
            is_nearer = score < best[i]
            best[i] = score if is_nearer else best[i]
            nearest[i] = own if is_nearer else nearest[i]
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def deepest_in_cones(points, may_meet, placed, cones):
    """The cone in which every point (M, 3) lies deepest, (M,); -1 where it lies in none.

    may_meet : (P, M) bool, parts whose cones count for a point.  placed : Placed.  cones : ConeArrays.
    """
    radii, part = cones.radii, cones.part
    columns = in_columns(points)
    x, y, z = columns[0], columns[1], columns[2]
    n = x.shape[0]
    most = np.zeros(n, np.float32)
    deepest = np.full(n, -1, np.int32)
    for k in range(radii.shape[0]):
        at, axis, inverse, first, last = _cone_of(placed, radii, k)
        taper = last - first
        meets = may_meet[part[k]]
        own = np.int32(k)
        for i in range(n):
            px = x[i] - at[0]
            py = y[i] - at[1]
            pz = z[i] - at[2]
            s = (px * axis[0] + py * axis[1] + pz * axis[2]) * inverse
            s = s if s > _ZERO else _ZERO
            s = s if s < _ONE else _ONE
            dx = px - s * axis[0]
            dy = py - s * axis[1]
            dz = pz - s * axis[2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            depth = first + s * taper - length
            is_deeper = (depth > most[i]) & meets[i] & (length > _THIN)
            most[i] = depth if is_deeper else most[i]
            deepest[i] = own if is_deeper else deepest[i]
    return deepest
