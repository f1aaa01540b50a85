"""Normal equations of the distance between a posed body and the silhouettes' outlines."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mocap.likelihood._surface_kernels import add_row, robust_loss


@njit(cache=True, nogil=True)
def outline_to_body(
    origins,
    directions,
    normals,
    start,
    end,
    radii,
    cone_joint,
    moving,
    scale,
    normal_cost,
    gain,
    H,
    g,
    residuals,
):
    """Pull the flesh until the rays through the outlines touch it; returns the robust cost.

    For every ray the cone is chosen that it touches best, by distance and by the angle between the outline's normal and
    the direction from the cone's axis to the ray.  residuals : (M,) filled with the signed distances, m.
    """
    n_cones = start.shape[0]
    columns = np.empty(H.shape[0], np.int64)
    values = np.empty(H.shape[0])
    x = np.empty(3)
    best_n = np.empty(3)
    slope = np.empty(3)
    n = np.empty(3)
    cost = 0.0
    middle = 0.5 * (start + end)
    reach = np.empty(n_cones)
    for k in range(n_cones):
        length = 0.0
        for c in range(3):
            length += (end[k, c] - start[k, c]) ** 2
        reach[k] = 0.5 * math.sqrt(length) + max(radii[k, 0], radii[k, 1])
    for i in range(origins.shape[0]):
        ox = origins[i, 0]
        oy = origins[i, 1]
        oz = origins[i, 2]
        ux = directions[i, 0]
        uy = directions[i, 1]
        uz = directions[i, 2]
        best = np.inf
        best_root = np.inf
        best_r = 0.0
        best_k = -1
        best_cos = 0.0
        for k in range(n_cones):
            # Distance of the ray to the cone's bounding sphere: most cones are out of the question.
            mx = middle[k, 0] - ox
            my = middle[k, 1] - oy
            mz = middle[k, 2] - oz
            along_ray = mx * ux + my * uy + mz * uz
            limit = reach[k] + best_root
            if mx * mx + my * my + mz * mz - along_ray * along_ray > limit * limit or along_ray < 0.0:
                continue
            ax = end[k, 0] - start[k, 0]
            ay = end[k, 1] - start[k, 1]
            az = end[k, 2] - start[k, 2]
            wx = start[k, 0] - ox
            wy = start[k, 1] - oy
            wz = start[k, 2] - oz
            aa = ax * ax + ay * ay + az * az + 1e-12
            au = ax * ux + ay * uy + az * uz
            aw = ax * wx + ay * wy + az * wz
            uw = ux * wx + uy * wy + uz * wz
            det = aa - au * au
            along = (au * uw - aw) / det if det > 1e-9 * aa else 0.5
            s = min(max(along, 0.0), 1.0)
            fx = wx + s * ax
            fy = wy + s * ay
            fz = wz + s * az
            depth = fx * ux + fy * uy + fz * uz
            # From the point on the axis to the nearest point of the ray.
            dx = depth * ux - fx
            dy = depth * uy - fy
            dz = depth * uz - fz
            length = math.sqrt(dx * dx + dy * dy + dz * dz)
            r = length - (radii[k, 0] + s * (radii[k, 1] - radii[k, 0]))
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
                x[0] = ox + depth * ux
                x[1] = oy + depth * uy
                x[2] = oz + depth * uz
                taper = (radii[k, 1] - radii[k, 0]) / aa if s == along else 0.0
                slope[0] = taper * ax
                slope[1] = taper * ay
                slope[2] = taper * az
        residuals[i] = best_r
        if best_k < 0:
            cost += gain * 0.5 * scale * scale
            continue
        loss, weight = robust_loss(best_r, scale, gain)
        cost += loss
        weight *= max(best_cos, 0.0)
        if weight > 1e-4 * gain:
            for c in range(3):
                n[c] = slope[c] - best_n[c]
            add_row(x, n, best_r, weight, cone_joint[best_k], moving, columns, values, H, g)
    return cost


@njit(cache=True, nogil=True)
def body_to_silhouettes(
    points,
    point_joint,
    R_cam,
    t_cam,
    intrinsics,
    corner,
    nearest,
    first,
    shape,
    moving,
    scale,
    gain,
    H,
    g,
    cost_of_camera,
):
    """Pull flesh points that project outside a silhouette back to its nearest pixel; returns the robust cost.

    nearest : flat int32, for the pixels of every camera's crop the linear index (within the crop) of the nearest
    silhouette pixel.  first, shape, corner : where a camera's crop starts in it, its (height, width), and the picture
    coordinates of its first pixel.  A point that falls outside a crop is taken to the crop's border first.
    """
    columns = np.empty(H.shape[0], np.int64)
    values = np.empty(H.shape[0])
    n = np.empty(3)
    cost = 0.0
    for v in range(R_cam.shape[0]):
        height = shape[v, 0]
        width = shape[v, 1]
        if height == 0:
            continue
        fx = intrinsics[v, 0]
        fy = intrinsics[v, 1]
        cx = intrinsics[v, 2]
        cy = intrinsics[v, 3]
        own = 0.0
        for i in range(points.shape[0]):
            cam0 = (
                R_cam[v, 0, 0] * points[i, 0] + R_cam[v, 0, 1] * points[i, 1] + R_cam[v, 0, 2] * points[i, 2]
            )
            cam1 = (
                R_cam[v, 1, 0] * points[i, 0] + R_cam[v, 1, 1] * points[i, 1] + R_cam[v, 1, 2] * points[i, 2]
            )
            cam2 = (
                R_cam[v, 2, 0] * points[i, 0] + R_cam[v, 2, 1] * points[i, 1] + R_cam[v, 2, 2] * points[i, 2]
            )
            cam0 += t_cam[v, 0]
            cam1 += t_cam[v, 1]
            cam2 += t_cam[v, 2]
            if cam2 < 0.1:
                continue
            u = fx * cam0 / cam2 + cx
            w = fy * cam1 / cam2 + cy
            # Out of the picture: the camera says nothing.
            if u < intrinsics[v, 4] or w < intrinsics[v, 5] or u > intrinsics[v, 6] or w > intrinsics[v, 7]:
                continue
            col = min(max(math.floor(u - corner[v, 0] + 0.5), 0), width - 1)
            row = min(max(math.floor(w - corner[v, 1] + 0.5), 0), height - 1)
            at = nearest[first[v] + row * width + col]
            du = u - (corner[v, 0] + at % width)
            dw = w - (corner[v, 1] + at // width)
            pixels = math.sqrt(du * du + dw * dw)
            if pixels < 1.0:
                continue
            du /= pixels
            dw /= pixels
            metres = (pixels - 0.5) * cam2 / (0.5 * (fx + fy))
            # The picture direction as a direction in the world: columns of the camera's axes.
            for c in range(3):
                n[c] = du * R_cam[v, 0, c] + dw * R_cam[v, 1, c]
            loss, weight = robust_loss(metres, scale, gain)
            own += loss
            if weight > 1e-4 * gain:
                add_row(points[i], n, metres, weight, point_joint[i], moving, columns, values, H, g)
        cost_of_camera[v] = own
        cost += own
    return cost
