"""The part of the room that the cameras can carve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mocap.data import CameraRig, VoxelGrid
from mocap.volume.carve import Carver, default_min_views, pixels_of_points

Array = NDArray[np.float64]

CEILING_M = 2.4  # a tall person with raised arms
MARGIN_M = 0.5
_COARSE_M = 0.1
_FILL = 0.85  # share of the table limit that an automatic grid may take


def choose_grid(
    rig: CameraRig,
    voxel_size_m: float,
    *,
    bounds_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None,
) -> VoxelGrid:
    """Voxel grid over the given bounds, or over the region that enough cameras have in common.

    bounds_m : (lower, upper) corners, m, world; they win over everything else.
    Without bounds: the box, from the floor z = 0 to 2.4 m, around all points seen by at least min(4, n)
    cameras within 0.5 m of the convex hull (in plan) of the camera positions and of their mirror images in
    the point the cameras look at (cameras along one wall enclose nothing by themselves). When the tables for
    that box would be too large, more cameras are required and then the box shrinks towards the middle of the
    common view.
    Raises ValueError when no point is seen by enough cameras, or for bad bounds.
    """
    if not voxel_size_m > 0:
        raise ValueError(f"voxel_size_m: expected a positive length, got {voxel_size_m}")
    if bounds_m is not None:
        return VoxelGrid.from_bounds(np.asarray(bounds_m[0]), np.asarray(bounds_m[1]), voxel_size_m)
    plan, inside = _plan_samples(rig)
    columns = plan[inside]
    heights = np.arange(_COARSE_M / 2, CEILING_M, _COARSE_M)
    points = np.concatenate([np.column_stack([columns, np.full(len(columns), z)]) for z in heights])
    n_seen = np.zeros(len(points), dtype=np.int64)
    for camera in rig:
        n_seen += pixels_of_points(camera, points) >= 0
    needed = default_min_views(len(rig))
    if not np.any(n_seen >= needed):
        raise ValueError(
            f"no point between the cameras and up to {CEILING_M} m above the floor z = 0 is seen by "
            f"{needed} of the {len(rig)} cameras; check the calibration's units and axes, or give room bounds"
        )
    for views in range(needed, int(n_seen.max()) + 1):
        grid = _box_around(points[n_seen >= views], voxel_size_m)
        if _fits(rig, grid):
            return grid
    middle = points[n_seen == n_seen.max()].mean(axis=0)
    for half in np.arange(3.0, 0.4, -0.1):
        near = np.all(np.abs(points[:, :2] - middle[:2]) <= half, axis=1) & (n_seen >= needed)
        grid = _box_around(points[near], voxel_size_m)
        if _fits(rig, grid):
            break
    return grid


def _fits(rig: CameraRig, grid: VoxelGrid) -> bool:
    from mocap.volume.carve import MAX_TABLE_MB

    return Carver.table_megabytes(len(rig), grid) <= _FILL * MAX_TABLE_MB


def _box_around(points: Array, voxel_size_m: float) -> VoxelGrid:
    lower = points.min(axis=0) - _COARSE_M / 2
    upper = points.max(axis=0) + _COARSE_M / 2
    lower[2] = 0.0
    return VoxelGrid.from_bounds(lower, upper, voxel_size_m)


def _plan_samples(rig: CameraRig) -> tuple[Array, NDArray[np.bool_]]:
    """Points (n, 2) m of a plan raster and whether each lies in the region where people may be."""
    import cv2

    centers = np.array([c.center for c in rig])
    target = look_at_point(rig)
    corners = np.concatenate([centers[:, :2], 2 * target[:2] - centers[:, :2]])
    hull = cv2.convexHull(corners.astype(np.float32)).reshape(-1, 2).astype(np.float64)
    lower, upper = hull.min(axis=0) - MARGIN_M, hull.max(axis=0) + MARGIN_M
    axes = [np.arange(lo + _COARSE_M / 2, hi, _COARSE_M) for lo, hi in zip(lower, upper, strict=True)]
    plan = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    if len(hull) < 3:
        gap = np.full(len(plan), MARGIN_M)
    else:
        contour = hull.astype(np.float32).reshape(-1, 1, 2)
        gap = np.array([cv2.pointPolygonTest(contour, (float(x), float(y)), True) for x, y in plan])
    return plan, gap >= -MARGIN_M


def look_at_point(rig: CameraRig) -> Array:
    """World point (3,) m nearest to all optical axes, in front of the cameras and within 6 m of them.

    Parallel axes meet nowhere: then it is the point 3 m in front of the mean camera.
    """
    centers = np.array([c.center for c in rig])
    axes = np.array([c.R[2] for c in rig])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal = across.sum(axis=0)
    ahead = centers.mean(axis=0) + 3.0 * axes.mean(axis=0)
    if np.linalg.eigvalsh(normal)[0] < 1e-3 * len(rig):
        return ahead
    point = np.linalg.solve(normal, np.einsum("cij,cj->i", across, centers))
    in_front = np.einsum("cj,cj->c", point - centers, axes) > 0
    if np.mean(in_front) < 0.5 or np.linalg.norm(point - centers, axis=1).min() > 6.0:
        return ahead
    return point
