"""Normal equations of the distance between a posed body and the silhouettes' outlines."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mocap.likelihood.residuals._nearest_kernels import nearest_to_rays
from mocap.likelihood.residuals._pull_kernels import (
    FleshPoints,
    add_pull,
    place_body,
    robust_loss,
    spread_pulls,
    taper_of,
)


class Rays(NamedTuple):
    """Rays through outline points.  origins, directions, normals : (M, 3), world; see `outlines.Outlines`.  columns :
    (9, M), the three as `nearest_to_rays` takes them."""

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    normals: NDArray[np.float64]
    columns: NDArray[np.float32]


class Pinholes(NamedTuple):
    """Cameras without distortion.  R : (C, 3, 3), t : (C, 3), world to camera.  intrinsics : (C, 8) fx, fy, cx, cy, and
    the smallest and largest u and v of the picture: (u0, v0, u1, v1)."""

    R: NDArray[np.float64]
    t: NDArray[np.float64]
    intrinsics: NDArray[np.float64]


class Crops(NamedTuple):
    """Nearest silhouette pixels in a crop of each picture.

    corner : (C, 2) picture coordinates of a crop's first pixel.  nearest : flat int32, for the pixels of every camera's
    crop the linear index, within the crop, of the nearest silhouette pixel.  first : (C,) where a camera's crop starts
    in it.  shape : (C, 2) height and width, 0 without a usable silhouette.
    """

    corner: NDArray[np.int64]
    nearest: NDArray[np.int32]
    first: NDArray[np.int64]
    shape: NDArray[np.int64]


class OutlinePull(NamedTuple):
    """How outlines and flesh pull each other: `OutlineFitSettings`, with the gain per point and camera."""

    scale_m: float
    normal_cost_m: float
    flesh_scale_m: float
    flesh_gain: float


class OutlineTerms(NamedTuple):
    """Everything of one frame that `outline_equations` takes."""

    rays: Rays
    flesh: FleshPoints
    cameras: Pinholes
    crops: Crops
    pull: OutlinePull


@njit(cache=True, nogil=True)
def nearest_of_labels(labels, inside):
    """Linear index of the pixel inside (H, W) that carries each pixel's label, (H, W) int32; every label has one."""
    flat = labels.ravel()
    is_inside = inside.ravel()
    home = np.zeros(flat.max() + 1, dtype=np.int32)
    for i in range(flat.shape[0]):
        if is_inside[i]:
            home[flat[i]] = i
    near = np.empty(flat.shape[0], dtype=np.int32)
    for i in range(flat.shape[0]):
        near[i] = home[flat[i]]
    return near.reshape(labels.shape)


@njit(cache=True, nogil=True)
def are_inside(at, corner, shape, size, border):
    """Which places (M, 2) of a crop, column and row, are neither at its rim nor within so many pixels of the picture's.

    corner : column and row of the crop's first pixel.  shape : its height and width.  size : the picture's width and
    height.
    """
    inside = np.empty(at.shape[0], np.bool_)
    for i in range(at.shape[0]):
        inside[i] = True
        for c in range(2):
            place = at[i, c] + corner[c]
            inside[i] &= 0 < at[i, c] < shape[1 - c] - 1 and border <= place < size[c] - border
    return inside


@njit(cache=True, nogil=True)
def rays_through(uv, normals, K, R):
    """Rays of a pinhole through places (M, 2) px of its picture, and normals (M, 2) of lines there, turned into the
    world and orthogonal to the rays: two (M, 3), unit length.  R : world to camera."""
    rays = np.empty((uv.shape[0], 3))
    outward = np.empty((uv.shape[0], 3))
    for i in range(uv.shape[0]):
        x = (uv[i, 0] - K[0, 2]) / K[0, 0]
        y = (uv[i, 1] - K[1, 2]) / K[1, 1]
        length = math.sqrt(x * x + y * y + 1.0)
        u = (x / length, y / length, 1.0 / length)
        along = normals[i, 0] * u[0] + normals[i, 1] * u[1]
        n = (normals[i, 0] - along * u[0], normals[i, 1] - along * u[1], -along * u[2])
        scale = 1.0 / max(math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), 1e-9)
        for c in range(3):
            rays[i, c] = u[0] * R[0, c] + u[1] * R[1, c] + u[2] * R[2, c]
            outward[i, c] = scale * (n[0] * R[0, c] + n[1] * R[1, c] + n[2] * R[2, c])
    return rays, outward


@njit(cache=True, nogil=True)
def mirrored(i, n):
    """An index into n pixels, of which the first and the last are mirrors."""
    i = abs(i)
    return max(i if i < n else 2 * n - 2 - i, 0)


@njit(cache=True, nogil=True)
def slopes_at(picture, at, blur, slope):
    """How a blurred picture (H, W) rises to the right and downwards at some pixels (M, 2), column and row: (M, 2).

    blur, slope : (2 n + 1,) weights of the neighbours in a row. Beyond its border the picture is mirrored.
    """
    reach = blur.shape[0] // 2
    height, width = picture.shape
    rises = np.zeros((at.shape[0], 2))
    for i in range(at.shape[0]):
        for b in range(-reach, reach + 1):
            row = mirrored(at[i, 1] + b, height)
            blurred = 0.0
            sloped = 0.0
            for a in range(-reach, reach + 1):
                value = picture[row, mirrored(at[i, 0] + a, width)]
                blurred += blur[reach + a] * value
                sloped += slope[reach + a] * value
            rises[i, 0] += blur[reach + b] * sloped
            rises[i, 1] += slope[reach + b] * blurred
    return rises


@njit(cache=True, nogil=True)
def _foot_on_axis(aa, au, aw, uw):
    """Place along an axis, unbounded, of the point nearest to a ray; the middle where both are parallel."""
    det = aa - au * au
    return (au * uw - aw) / det if det > 1e-9 * aa else 0.5


@njit(cache=True, nogil=True)
def _foot_of_ray(o, u, start, end, k):
    """Where a ray passes the axis of cone k: place along it in [0, 1], depth along the ray, and the way from the axis
    to the ray, three numbers.  o, u : three numbers each, origin and direction."""
    ax = end[k, 0] - start[k, 0]
    ay = end[k, 1] - start[k, 1]
    az = end[k, 2] - start[k, 2]
    wx = start[k, 0] - o[0]
    wy = start[k, 1] - o[1]
    wz = start[k, 2] - o[2]
    au = ax * u[0] + ay * u[1] + az * u[2]
    aw = ax * wx + ay * wy + az * wz
    uw = u[0] * wx + u[1] * wy + u[2] * wz
    s = min(max(_foot_on_axis(ax * ax + ay * ay + az * az + 1e-12, au, aw, uw), 0.0), 1.0)
    fx = wx + s * ax
    fy = wy + s * ay
    fz = wz + s * az
    depth = fx * u[0] + fy * u[1] + fz * u[2]
    return s, depth, (depth * u[0] - fx, depth * u[1] - fy, depth * u[2] - fz)


@njit(cache=True, nogil=True)
def outline_to_body(rays, placed, cones, pull, pulls):
    """Pull the flesh until the rays through the outlines touch it; returns the robust cost.

    For every ray the cone is chosen that it touches best, by distance and by the angle between the outline's normal and
    the direction from the cone's axis to the ray.
    """
    # Unpacked once: taken from a tuple inside the loop each array would cost a reference count.
    origins, directions, normals, columns = rays
    start, end, radii, cone_joint = placed.start, placed.end, cones.radii, cones.joint
    scale = pull.scale_m
    nearest = nearest_to_rays(columns, placed, radii, pull.normal_cost_m)
    cost = 0.0
    for i in range(origins.shape[0]):
        k = nearest[i]
        if k < 0:
            cost += 0.5 * scale * scale
            continue
        o = (origins[i, 0], origins[i, 1], origins[i, 2])
        u = (directions[i, 0], directions[i, 1], directions[i, 2])
        s, depth, d = _foot_of_ray(o, u, start, end, k)
        length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        inv = 1.0 / max(length, 1e-9)
        cosine = (d[0] * normals[i, 0] + d[1] * normals[i, 1] + d[2] * normals[i, 2]) * inv
        widening = radii[k, 1] - radii[k, 0]
        r = length - (radii[k, 0] + s * widening)
        loss, weight = robust_loss(r, scale, 1.0)
        cost += loss
        weight *= max(cosine, 0.0)
        if weight > 1e-4:
            at = (o[0] + depth * u[0], o[1] + depth * u[1], o[2] + depth * u[2])
            t = taper_of(start, end, k, widening, s)
            n = (t[0] - d[0] * inv, t[1] - d[1] * inv, t[2] - d[2] * inv)
            add_pull(at, n, r, weight, cone_joint[k], pulls)
    return cost


@njit(cache=True, nogil=True)
def _is_beyond(u, v, intrinsics, camera):
    """Whether a place of a camera lies beyond its picture."""
    low = u < intrinsics[camera, 4] or v < intrinsics[camera, 5]
    return low or u > intrinsics[camera, 6] or v > intrinsics[camera, 7]


@njit(cache=True, nogil=True)
def body_to_silhouettes(points, point_joint, cameras, crops, pull, pulls):
    """Pull flesh points (M, 3) that project outside a silhouette back to its nearest pixel; returns the robust cost.

    A point that falls outside a crop is taken to the crop's border first.
    """
    R_cam, t_cam, intrinsics = cameras
    corner, nearest, first, shape = crops
    scale, gain = pull.flesh_scale_m, pull.flesh_gain
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
            if _is_beyond(u, w, intrinsics, v):
                continue
            col = min(max(math.floor(u - corner[v, 0] + 0.5), 0), width - 1)
            row = min(max(math.floor(w - corner[v, 1] + 0.5), 0), height - 1)
            pixel = nearest[first[v] + row * width + col]
            du = u - (corner[v, 0] + pixel % width)
            dw = w - (corner[v, 1] + pixel // width)
            pixels = math.sqrt(du * du + dw * dw)
            if pixels < 1.0:
                continue
            du /= pixels
            dw /= pixels
            metres = (pixels - 0.5) * cam2 / (0.5 * (fx + fy))
            loss, weight = robust_loss(metres, scale, gain)
            own += loss
            if weight > 1e-4 * gain:
                # The picture direction as a direction in the world: columns of the camera's axes.
                n = (
                    du * R_cam[v, 0, 0] + dw * R_cam[v, 1, 0],
                    du * R_cam[v, 0, 1] + dw * R_cam[v, 1, 1],
                    du * R_cam[v, 0, 2] + dw * R_cam[v, 1, 2],
                )
                at = (points[i, 0], points[i, 1], points[i, 2])
                add_pull(at, n, metres, weight, point_joint[i], pulls)
        cost += own
    return cost


@njit(cache=True, nogil=True)
def outline_equations(state, body, outlines, H, g):
    """Robust cost of a state (D,); adds its normal equations to H (D, D) and g (D,).

    body : BodyArrays.  outlines : OutlineTerms.
    """
    placed = place_body(state, body, outlines.flesh)
    pulls = np.zeros((placed.t.shape[0], 7, 6))
    cost = outline_to_body(outlines.rays, placed, body.cones, outlines.pull, pulls)
    cost += body_to_silhouettes(
        placed.flesh, outlines.flesh.joint, outlines.cameras, outlines.crops, outlines.pull, pulls
    )
    spread_pulls(pulls, body, placed.t, placed.axes, H, g)
    return cost
