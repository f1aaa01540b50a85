"""Depth maps and hulls: before a measured surface all is empty, and the hull's surface lies where it was measured.

Behind a measured surface nothing is known: there silhouettes alone speak, as without depth. A pixel without a reading
says nothing either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.data import Camera, VoxelGrid
from mocap.data.depth import DepthNoise
from mocap.data.voxels import Voxels
from mocap.volume.carve import pixels_of_points

DepthMap = NDArray[np.float32]

# A voxel is empty when the nearest reading in its square lies further behind it than so many deviations: of true bodies
# that takes out 1 voxel of 10 000 on depth_walk and depth_gesture, with none 14.
_FREE_STDS = 1.0
# A voxel is of a measured surface when readings lie at most so many deviations, and a voxel, behind it, or one
# deviation and half a voxel before it: a wrist's far side is 5 cm behind its near side.
_NEAR_STDS = 3.0
_MIN_SHARE = 0.25  # of the pixels in a voxel's square that must have such readings
_MOST_RADIUS_PX = 6  # of a voxel's square; close to a camera the pixels around its middle tell enough


@dataclass(frozen=True, eq=False)
class DepthView:
    """What one camera has measured in one frame.  depth_m : (H, W) float32 m along the optical axis, 0 = no reading."""

    camera: Camera
    depth_m: DepthMap
    noise: DepthNoise


@dataclass(frozen=True, eq=False)
class _Seen:
    """Points that a view has in its picture.  rows : (n,) of the points.  u, v : (n,) px.  depth : (n,) m."""

    rows: NDArray[np.int64]
    u: NDArray[np.int64]
    v: NDArray[np.int64]
    depth: Array
    radius_px: int


def is_free(voxels: Voxels, grid: VoxelGrid, views: Sequence[DepthView]) -> NDArray[np.bool_]:
    """Which voxels (N,) lie before a surface that a view has measured, (N,).

    The whole voxel must: the nearest reading in its square counts, and the one in its middle must be there.
    """
    free = np.zeros(len(voxels), dtype=np.bool_)
    centers = grid.centers(voxels)
    for view in views:
        seen = _seen(view, centers, grid.voxel_size_m)
        side = 2 * seen.radius_px + 1
        far = np.where(view.depth_m > 0, view.depth_m, np.float32(np.inf))
        nearest = cv2.erode(far, np.ones((side, side), np.uint8))[seen.v, seen.u].astype(np.float64)
        is_read = view.depth_m[seen.v, seen.u] > 0
        with np.errstate(invalid="ignore"):
            limit = nearest - _FREE_STDS * view.noise.std_m(nearest) - 0.5 * grid.voxel_size_m
        free[seen.rows] |= is_read & (seen.depth < limit)
    return free


def measured_surface(voxels: Voxels, grid: VoxelGrid, views: Sequence[DepthView]) -> NDArray[np.float32]:
    """Where the surface of voxels (N,) was measured, (N, 3) m; NaN where no view has measured it.

    The middle of each voxel, moved along the line of sight to the mean of the readings near it, and to the mean of the
    views that have some.
    """
    centers = grid.centers(voxels)
    total, n_views = np.zeros((len(voxels), 3)), np.zeros(len(voxels))
    for view in views:
        seen = _seen(view, centers, grid.voxel_size_m)
        mean, share = _mean_reading(view, seen, grid.voxel_size_m)
        use = share >= _MIN_SHARE
        rows, eye = seen.rows[use], view.camera.center
        total[rows] += eye + (centers[rows] - eye) * (mean[use] / seen.depth[use])[:, None]
        n_views[rows] += 1
    with np.errstate(invalid="ignore", divide="ignore"):
        return (total / n_views[:, None]).astype(np.float32)


def _seen(view: DepthView, points: Array, voxel_m: float) -> _Seen:
    """The points (N, 3) m that a view has in its picture, and the radius of a voxel there, px."""
    camera = view.camera
    pixel = pixels_of_points(camera, points)
    rows = np.flatnonzero(pixel >= 0)
    depth = points[rows] @ camera.R[2] + camera.t[2]
    v, u = np.divmod(pixel[rows].astype(np.int64), camera.size[0])
    middle = float(np.median(depth)) if len(rows) else 1.0
    radius = round(0.5 * voxel_m * float(camera.K[0, 0]) / middle)
    return _Seen(rows, u, v, depth, min(max(radius, 1), _MOST_RADIUS_PX))


def _mean_reading(view: DepthView, seen: _Seen, voxel_m: float) -> tuple[Array, Array]:
    """Mean of the readings around each point that lie near it, (n,) m, and their share of the square's pixels, (n,)."""
    r, std = seen.radius_px, view.noise.std_m(seen.depth)
    behind, before = voxel_m + _NEAR_STDS * std, 0.5 * voxel_m + std
    padded = np.pad(view.depth_m, r)
    total, n = np.zeros(len(seen.rows)), np.zeros(len(seen.rows))
    for dv in range(2 * r + 1):
        for du in range(2 * r + 1):
            own = padded[seen.v + dv, seen.u + du].astype(np.float64)
            is_near = (own > 0) & (own - seen.depth < behind) & (seen.depth - own < before)
            total += np.where(is_near, own, 0.0)
            n += is_near
    return total / np.maximum(n, 1), n / (2 * r + 1) ** 2
