"""Which zone of a posed body a camera sees in a pixel."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def bounding_spheres(start, end, radii, middle, squared, reach):
    """Fill middle (K, 3), squared axis length (K,) and radius (K,) of the spheres around cones."""
    for k in range(start.shape[0]):
        square = 1e-12
        for c in range(3):
            middle[k, c] = 0.5 * (start[k, c] + end[k, c])
            square += (end[k, c] - start[k, c]) ** 2
        squared[k] = square
        reach[k] = 0.5 * math.sqrt(square) + max(radii[k, 0], radii[k, 1])


@njit(cache=True, nogil=True)
def first_cone(o, u, start, end, radii, middle, squared, reach, depth, miss):
    """What a ray from o along u meets before `depth`, or failing that passes more closely than `miss`.

    Returns the cone (-1 for none), the place along its axis (0 to 1), the depth at which the ray enters it (inf when it
    passes by), and by how much it misses it (0 when it enters).
    """
    cone = -1
    at = 0.0
    has_hit = miss <= 0.0
    for k in range(start.shape[0]):
        mx = middle[k, 0] - o[0]
        my = middle[k, 1] - o[1]
        mz = middle[k, 2] - o[2]
        along_ray = mx * u[0] + my * u[1] + mz * u[2]
        limit = reach[k] + miss
        if mx * mx + my * my + mz * mz - along_ray * along_ray > limit * limit:
            continue
        if along_ray < 0.0 or along_ray - reach[k] >= depth:
            continue
        ax = end[k, 0] - start[k, 0]
        ay = end[k, 1] - start[k, 1]
        az = end[k, 2] - start[k, 2]
        wx = start[k, 0] - o[0]
        wy = start[k, 1] - o[1]
        wz = start[k, 2] - o[2]
        au = ax * u[0] + ay * u[1] + az * u[2]
        aw = ax * wx + ay * wy + az * wz
        uw = u[0] * wx + u[1] * wy + u[2] * wz
        det = squared[k] - au * au
        s = (au * uw - aw) / det if det > 1e-9 * squared[k] else 0.5
        s = min(max(s, 0.0), 1.0)
        fx = wx + s * ax
        fy = wy + s * ay
        fz = wz + s * az
        nearest = fx * u[0] + fy * u[1] + fz * u[2]
        square = fx * fx + fy * fy + fz * fz - nearest * nearest
        radius = radii[k, 0] + s * (radii[k, 1] - radii[k, 0])
        if square < radius * radius:
            entry = nearest - math.sqrt(radius * radius - max(square, 0.0))
            if entry < depth:
                depth = entry
                miss = 0.0
                cone = k
                at = s
                has_hit = True
        elif not has_hit:
            gap = math.sqrt(square) - radius
            if gap < miss:
                miss = gap
                cone = k
                at = s
    return cone, at, depth, miss


@njit(cache=True, nogil=True)
def zones_of_rays(
    origins, camera, directions, start, end, radii, first_zone, n_zones, touch, zone, depth, miss
):
    """Zone that every ray (M,) meets first, or passes most closely, at most `touch` away; -1 for none.

    origins : (C, 3) of the cameras.  camera : (M,).  directions : (M, 3) unit.  first_zone, n_zones : (K,), along a cone.
    depth, miss : (M,), filled as by `first_cone`.
    """
    n = start.shape[0]
    middle = np.empty((n, 3))
    squared = np.empty(n)
    reach = np.empty(n)
    bounding_spheres(start, end, radii, middle, squared, reach)
    for i in range(camera.shape[0]):
        k, s, d, m = first_cone(
            origins[camera[i]], directions[i], start, end, radii, middle, squared, reach, np.inf, touch
        )
        zone[i] = -1 if k < 0 else first_zone[k] + min(int(s * n_zones[k]), n_zones[k] - 1)
        depth[i] = d
        miss[i] = m


@njit(cache=True, nogil=True)
def limb_values(
    origins,
    camera,
    directions,
    bins,
    table,
    other_depth,
    other_miss,
    other_value,
    start,
    end,
    radii,
    first_zone,
    n_zones,
    values,
):
    """Sum over the rays of their colours' log-ratios when one limb moves and the rest of the body holds still.

    start, end : (N, K, 3) cones of the limb for N particles.  other_depth, other_miss, other_value : (M,), what the rest
    of the body gives.  values : (N,) is filled.
    """
    n_cones = start.shape[1]
    middle = np.empty((n_cones, 3))
    squared = np.empty(n_cones)
    reach = np.empty(n_cones)
    base = 0.0
    for i in range(camera.shape[0]):
        base += other_value[i]
    for n in range(start.shape[0]):
        bounding_spheres(start[n], end[n], radii, middle, squared, reach)
        # A sphere around the limb: most rays pass it by.
        cx = 0.0
        cy = 0.0
        cz = 0.0
        for k in range(n_cones):
            cx += middle[k, 0] / n_cones
            cy += middle[k, 1] / n_cones
            cz += middle[k, 2] / n_cones
        whole = 0.0
        for k in range(n_cones):
            dx = middle[k, 0] - cx
            dy = middle[k, 1] - cy
            dz = middle[k, 2] - cz
            whole = max(whole, math.sqrt(dx * dx + dy * dy + dz * dz) + reach[k])
        total = base
        for i in range(camera.shape[0]):
            o = origins[camera[i]]
            u = directions[i]
            mx = cx - o[0]
            my = cy - o[1]
            mz = cz - o[2]
            along = mx * u[0] + my * u[1] + mz * u[2]
            limit = whole + other_miss[i]
            if mx * mx + my * my + mz * mz - along * along > limit * limit or along - whole > other_depth[i]:
                continue
            k, s, _, _ = first_cone(
                o, u, start[n], end[n], radii, middle, squared, reach, other_depth[i], other_miss[i]
            )
            if k >= 0:
                zone = first_zone[k] + min(int(s * n_zones[k]), n_zones[k] - 1)
                total += table[zone, bins[i]] - other_value[i]
        values[n] = total
