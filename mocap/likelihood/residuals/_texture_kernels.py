"""Kernels of texture: which places of the flesh cameras see, what colours they see there, and how those pull a pose."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mocap.body._kernels import chain_axes
from mocap.likelihood.colours._kernels import see_cones
from mocap.likelihood.residuals._pull_kernels import add_pull, place_points, robust_loss, spread_pulls

_NEAREST_M = 0.1  # what lies nearer to a camera is not in its picture


class Places(NamedTuple):
    """Places on the flesh, each in the frame of its joint.  points, normals : (M, 3), m and outward unit vectors.
    joint : (M,)."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    joint: NDArray[np.int64]


class Crops(NamedTuple):
    """What C cameras show around one person: pieces of their pictures, as pinholes see them, one after the other.

    colours : (P, 3) luma and chroma, smoothed, row after row.  is_clear : (P,) whether nothing is known to stand before
    the person there.  first, shape : (C,), (C, 2), of each piece, rows and columns; (0, 0) = shows nothing.  R, t :
    (C, 3, 3), (C, 3), world to camera.  focal, middle : (C, 2) pixels of the piece.
    """

    colours: NDArray[np.uint8]
    is_clear: NDArray[np.bool_]
    first: NDArray[np.int64]
    shape: NDArray[np.int64]
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    focal: NDArray[np.float64]
    middle: NDArray[np.float64]


class TextureTerms(NamedTuple):
    """Known colours of places.  mean, inverse : (M, 3), the latter of deviations, 0 = not known.  scale : deviations
    at which a colour loses three quarters of its pull."""

    mean: NDArray[np.float64]
    inverse: NDArray[np.float64]
    scale: float


@njit(cache=True, nogil=True)
def _in_camera(crops, c, x, y, z):
    """A point of the world in the frame of a camera."""
    R, t = crops.R[c], crops.t[c]
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0],
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1],
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2],
    )


@njit(cache=True, nogil=True)
def _cell(crops, c, x, y, z):
    """The pixel of a crop, column and row, up and left of where a point in the frame of its camera lies, and the rest
    of the way, in pixels; the column is -1 outside."""
    if z < _NEAREST_M:
        return -1, -1, 0.0, 0.0
    u = crops.focal[c, 0] * x / z + crops.middle[c, 0]
    v = crops.focal[c, 1] * y / z + crops.middle[c, 1]
    if not (0.0 <= u < crops.shape[c, 1] - 1 and 0.0 <= v < crops.shape[c, 0] - 1):
        return -1, -1, 0.0, 0.0
    column, row = int(u), int(v)
    return column, row, u - column, v - row


@njit(cache=True, nogil=True)
def _colour(colours, pixel, width, a, b, k):
    """A channel between four pixels, a to the right of one and b below it, and how it grows to the right and down."""
    here, right = np.float64(colours[pixel, k]), np.float64(colours[pixel + 1, k])
    below, beyond = np.float64(colours[pixel + width, k]), np.float64(colours[pixel + width + 1, k])
    colour = (1 - b) * ((1 - a) * here + a * right) + b * ((1 - a) * below + a * beyond)
    return (
        colour,
        (1 - b) * (right - here) + b * (beyond - below),
        (1 - a) * (below - here) + a * (beyond - right),
    )


@njit(cache=True, nogil=True)
def _posed(state, body, places):
    """What a state (D,) does to a body: joints (J, 3, 3), (J, 3), rotation axes, places and their normals (M, 3)."""
    chain = body.chain
    J = chain.parent.shape[0]
    R, t, axes = np.empty((J, 3, 3)), np.empty((J, 3)), np.empty((chain.dof_joint.shape[0], 3))
    chain_axes(state, chain, R, t, axes)
    points, normals = np.empty_like(places.points), np.empty_like(places.normals)
    place_points(places.points, places.joint, R, t, points)
    place_points(places.normals, places.joint, R, np.zeros((J, 3)), normals)
    return R, t, axes, points, normals


@njit(cache=True, nogil=True)
def see_places(state, body, places, crops, least_cosine, slack_m, seen):
    """Which places every camera sees under a state (D,), into seen (C, M): those that face it, more than grazed, with
    no flesh more than `slack_m` before them, where the picture is clear."""
    R, t, _, points, normals = _posed(state, body, places)
    cones, M = body.cones, points.shape[0]
    start, end = np.empty_like(cones.start), np.empty_like(cones.end)
    place_points(cones.start, cones.joint, R, t, start)
    place_points(cones.end, cones.joint, R, t, end)
    columns, distance = np.empty((6, M), np.float32), np.empty(M)
    miss, at = np.zeros(M, np.float32), np.zeros(M, np.float32)
    for c in range(crops.first.shape[0]):
        if crops.shape[c, 0] == 0:
            seen[c] = False
            continue
        for r in range(3):
            eye = 0.0
            for a in range(3):
                eye -= crops.R[c, a, r] * crops.t[c, a]
            columns[r] = eye
        for i in range(M):
            dx, dy, dz = (
                points[i, 0] - columns[0, i],
                points[i, 1] - columns[1, i],
                points[i, 2] - columns[2, i],
            )
            distance[i] = max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
            columns[3, i], columns[4, i], columns[5, i] = (
                dx / distance[i],
                dy / distance[i],
                dz / distance[i],
            )
        depth, cone = np.full(M, np.float32(np.inf)), np.full(M, np.int32(-1))
        see_cones(columns, start, end, cones.radii, depth, miss, cone, at)
        for i in range(M):
            facing = -(
                normals[i, 0] * columns[3, i] + normals[i, 1] * columns[4, i] + normals[i, 2] * columns[5, i]
            )
            seen[c, i] = facing > least_cosine and depth[i] > distance[i] - slack_m
            if seen[c, i]:
                x, y, z = _in_camera(crops, c, points[i, 0], points[i, 1], points[i, 2])
                column, row, _, _ = _cell(crops, c, x, y, z)
                pixel = crops.first[c] + row * crops.shape[c, 1] + column
                seen[c, i] = column >= 0 and crops.is_clear[pixel]


@njit(cache=True, nogil=True)
def count_colours(state, body, places, crops, seen, counts):
    """Add what is seen (C, M) of places under a state (D,) to the counts of their colours (M, 3, 256)."""
    _, _, _, points, _ = _posed(state, body, places)
    for c in range(seen.shape[0]):
        for i in range(seen.shape[1]):
            if not seen[c, i]:
                continue
            x, y, z = _in_camera(crops, c, points[i, 0], points[i, 1], points[i, 2])
            column, row, a, b = _cell(crops, c, x, y, z)
            if column < 0:
                continue
            pixel = crops.first[c] + row * crops.shape[c, 1] + column
            for k in range(3):
                colour, _, _ = _colour(crops.colours, pixel, crops.shape[c, 1], a, b, k)
                counts[i, k, int(colour + 0.5)] += 1


@njit(cache=True, nogil=True)
def texture_equations(state, body, places, crops, seen, known, H, g):
    """Robust cost of a state (D,), half the squared deviations summed over what is seen (C, M) and channels; adds its
    normal equations to H (D, D) and g (D,). A place that has left the picture costs what a colour can at most."""
    _, t, axes, points, _ = _posed(state, body, places)
    pulls = np.zeros((t.shape[0], 7, 6))
    most = 3.0 * 0.5 * known.scale * known.scale
    cost = 0.0
    for c in range(seen.shape[0]):
        R, width = crops.R[c], crops.shape[c, 1]
        for i in range(seen.shape[1]):
            if not seen[c, i] or known.inverse[i, 0] == 0.0:
                continue
            x, y, z = _in_camera(crops, c, points[i, 0], points[i, 1], points[i, 2])
            column, row, a, b = _cell(crops, c, x, y, z)
            if column < 0:
                cost += most
                continue
            pixel = crops.first[c] + row * width + column
            place = (points[i, 0], points[i, 1], points[i, 2])
            for k in range(3):
                colour, du, dv = _colour(crops.colours, pixel, width, a, b, k)
                inverse = known.inverse[i, k]
                residual = (colour - known.mean[i, k]) * inverse
                loss, weight = robust_loss(residual, known.scale, 1.0)
                cost += loss
                du *= inverse * crops.focal[c, 0] / z
                dv *= inverse * crops.focal[c, 1] / z
                dz = -(du * x + dv * y) / z
                pull = (
                    du * R[0, 0] + dv * R[1, 0] + dz * R[2, 0],
                    du * R[0, 1] + dv * R[1, 1] + dz * R[2, 1],
                    du * R[0, 2] + dv * R[1, 2] + dz * R[2, 2],
                )
                add_pull(place, pull, residual, weight, places.joint[i], pulls)
    spread_pulls(pulls, body, t, axes, H, g)
    return cost
